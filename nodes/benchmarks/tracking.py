"""`hierax bench tracking`: what context, physics and prior do for tracking, and how fast it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors, Score, object_errors, score
from hierax.nodes.tracking.generator.kinds import KINDS
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.plain import Json
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.execution.single import run
from hierax.runtime.launch.supervisor import launch
from hierax.runtime.watch.meter import EDGES, OBSERVE, PREDICT, Meter

DEPLOYMENT = "tracking"
WAYS = {
    "own model": ("occlusion=false",),
    "context, no physics": ("physics=false",),
    "context, no prior": ("prior=false",),
    "with all": (),
}
"""What is set of the deployment. An object's own model is what it shows when no other object is there."""

CONTEXT, OWN = "with all", "own model"
STAGES = ("world", "arm", "spatial")
"""Nodes whose time is told; each with the edge functions that run in it."""

SPEED_KIND = "scattered"
SPEED_OBJECTS = (1, 5)
_POSES = "poses.csv"

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Scene:
    """A scene to be tracked.

    Attributes:
        name: what scenes are put together by: the kind, or the folder's name.
        seed: of a generated scene; 0 of others.
        folder: of the BOP scene.
        truth: the folder with the true poses.
        table: whether the world's plane z = 0 carries the objects.
    """

    name: str
    seed: int
    folder: Path
    truth: Path
    table: bool


@dataclass(frozen=True)
class Tracked:
    """One scene, tracked in one way.

    Attributes:
        scene, way: which.
        errors: of each object, as scoring gives them.
        stage_ms: by node, the processor's time of an epoch in its operators and edge functions, in milliseconds.
    """

    scene: Scene
    way: str
    errors: Sequence[ObjectErrors]
    stage_ms: dict[str, float]


@dataclass(frozen=True)
class Row:
    """All scenes of one name, tracked in one way.

    Attributes:
        name, way: which.
        score: of all objects of all of them.
        stage_ms: by node, the median of the scenes.
        hidden_shares: of each scene, the share within 5 mm and 5° where more than half of an object is
            hidden; nan where there is no such frame.
    """

    name: str
    way: str
    score: Score
    stage_ms: dict[str, float]
    hidden_shares: Sequence[float]

    def plain(self) -> dict[str, Json]:
        """As plain JSON."""
        hidden: list[Json] = [None if np.isnan(share) else share for share in self.hidden_shares]
        return {
            "scene": self.name,
            "way": self.way,
            **self.score.plain(),
            "stage_ms": dict(self.stage_ms),
            "hidden_shares": hidden,
        }


@dataclass(frozen=True)
class Gain:
    """What context is worth on hidden objects: share within 5 mm and 5° with all, less that of own models.

    Attributes:
        name: of the scenes.
        differences: one for each seed.
    """

    name: str
    differences: Sequence[float]

    def plain(self) -> dict[str, Json]:
        """As plain JSON; the spread is the standard deviation over the seeds."""
        known = np.array(self.differences)
        return {
            "scene": self.name,
            "seeds": len(known),
            "mean": float(known.mean()),
            "spread": float(known.std(ddof=1)) if len(known) > 1 else None,
            "least": float(known.min()),
            "most": float(known.max()),
        }


@dataclass(frozen=True)
class Speed:
    """A launch over Zenoh.

    Attributes:
        objects: how many there are.
        epochs_hz: of each round, epochs per second from the first epoch's beginning to the last one's commit.
        stage_ms: by node, the processor's time of an epoch, measured in one process.
    """

    objects: int
    epochs_hz: Sequence[float]
    stage_ms: dict[str, float]

    def plain(self) -> dict[str, Json]:
        """As plain JSON."""
        rates: list[Json] = list(self.epochs_hz)
        return {
            "objects": self.objects,
            "epochs_hz": float(np.median(self.epochs_hz)),
            "rounds": rates,
            "stage_ms": dict(self.stage_ms),
        }


def kinds() -> list[str]:
    """The kinds of scenes that can be generated."""
    return list(KINDS)


def generated(names: Sequence[str], seeds: int, frames: int, exact: bool, folder: Path, told: Tell) -> list[Scene]:
    """Write scenes.

    Args:
        names: of their kinds.
        seeds: how many of each kind, from seed 0 on.
        frames: of each.
        exact: whether start and camera are told as they are.
        folder: where the datasets go.
        told: told what is going on.

    Raises:
        HieraxError: something cannot be written.
    """
    scenes = []
    for name in names:
        for seed in range(seeds):
            told(f"{name}, seed {seed}: drawing {frames} frames")
            out = folder / f"{name}-{seed}{'-exact' if exact else ''}-{frames}"
            scene = write_scene(out, name, seed, frames, exact)
            scenes.append(Scene(name, seed, scene, out / "truth" / scene.name, True))
    return scenes


def bench_tracking(
    scenes: Sequence[Scene], ways: Sequence[str], settings: Sequence[str], folder: Path, told: Tell
) -> list[Row]:
    """Track scenes in several ways.

    Args:
        scenes: which.
        ways: of `WAYS`.
        settings: further ones of the deployment, ``path=value``.
        folder: where results files go.
        told: told what is going on.

    Raises:
        HieraxError: a scene cannot be read, or a node failed.
    """
    done = []
    for scene in scenes:
        for way in ways:
            told(f"{scene.name}, seed {scene.seed}: {way}")
            done.append(_track(scene, way, settings, folder))
    names = list(dict.fromkeys(scene.name for scene in scenes))
    return [
        _row(name, way, [each for each in done if (each.scene.name, each.way) == (name, way)])
        for name in names
        for way in ways
    ]


def gains(rows: Sequence[Row]) -> list[Gain]:
    """Context against own models, where both ways were tracked and something was hidden."""
    shares = {(row.name, row.way): np.array(row.hidden_shares) for row in rows}
    found = []
    for name in dict.fromkeys(row.name for row in rows):
        if (name, CONTEXT) in shares and (name, OWN) in shares:
            differences = shares[name, CONTEXT] - shares[name, OWN]
            known = differences[~np.isnan(differences)]
            if len(known):
                found.append(Gain(name, known.tolist()))
    return found


def bench_speed(frames: int, rounds: int, settings: Sequence[str], folder: Path, told: Tell) -> list[Speed]:
    """Launch the deployment over Zenoh, each node a process, on scenes of one object and of several.

    Args:
        frames: of each scene, read from disk ahead of time.
        rounds: how often each is launched, in turn.
        settings: further ones of the deployment.
        folder: where the datasets go.
        told: told what is going on.

    Raises:
        HieraxError: a process failed.
    """
    deployments = {}
    for objects in SPEED_OBJECTS:
        told(f"drawing {frames} frames with {objects} objects")
        scene = write_scene(folder / f"speed-{objects}", SPEED_KIND, 0, frames, False, objects)
        deployments[objects] = read_deployment(DEPLOYMENT, [f"scene={scene}", "table=true", *settings])
    rates: dict[int, list[float]] = {objects: [] for objects in SPEED_OBJECTS}
    for number in range(rounds):
        for objects, deployment in deployments.items():
            told(f"{objects} objects, round {number + 1} of {rounds}")
            report = launch(deployment, epochs=None, seed=0)
            rates[objects].append(report.epochs_per_s or 0.0)
    return [Speed(objects, rates[objects], _stages_ms(deployment)) for objects, deployment in deployments.items()]


def _track(scene: Scene, way: str, settings: Sequence[str], folder: Path) -> Tracked:
    poses = folder / f"{scene.name}-{scene.seed}-{way.replace(' ', '-').replace(',', '')}.{_POSES}"
    changes = [f"scene={scene.folder}", f"table={str(scene.table).lower()}", f"output={poses}", *WAYS[way], *settings]
    stage_ms = _stages_ms(read_deployment(DEPLOYMENT, changes))
    return Tracked(scene, way, object_errors(read_results(poses), read_truth(scene.truth)), stage_ms)


def _stages_ms(deployment: Deployment) -> dict[str, float]:
    """Run a deployment in this process; by node, how long an epoch takes in its operators."""
    meters: dict[str, Meter] = {}
    run(deployment, epochs=None, seed=0, watch=partial(_meter, meters))
    return {name: _stage_ms(meters[name]) for name in STAGES if name in meters}


def _meter(meters: dict[str, Meter], name: str, runner: NodeRunner) -> None:
    # The time of this thread alone: other programs on the machine do not count.
    meters[name] = Meter(time.thread_time_ns)
    runner.watch(meters[name])


def _stage_ms(meter: Meter) -> float:
    read = meter.read()
    work = read["work_ns"]
    return float(sum(work[kind] for kind in (OBSERVE, PREDICT, EDGES)) / max(1, read["epochs"]) / 1e6)


def _row(name: str, way: str, done: Sequence[Tracked]) -> Row:
    stages = {stage: float(np.median([each.stage_ms[stage] for each in done])) for stage in done[0].stage_ms}
    hidden = [score(each.errors).hidden.shares[1] for each in done]
    return Row(name, way, score([item for each in done for item in each.errors]), stages, hidden)


def known_ways(wanted: Sequence[str]) -> list[str]:
    """The ways that are wanted, in the order of `WAYS`; all, where none are named.

    Raises:
        HieraxError: there is no such way.
    """
    return _chosen("way", wanted, list(WAYS))


def known_kinds(wanted: Sequence[str]) -> list[str]:
    """The kinds that are wanted, in their order; all, where none are named.

    Raises:
        HieraxError: there is no such kind.
    """
    return _chosen("kind", wanted, kinds())


def _chosen(what: str, wanted: Sequence[str], known: Sequence[str]) -> list[str]:
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise HieraxError(f"there is no {what} {unknown[0]!r}; expected some of {', '.join(known)}")
    return [name for name in known if not wanted or name in wanted]
