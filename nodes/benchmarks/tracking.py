"""`hierax bench tracking`: what context, physics and prior do for tracking, and how fast it is."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.evaluation.calibration import Calibration, calibration, is_told, judge
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors, Score, object_errors, score
from hierax.nodes.tracking.generator.kinds import CROWD, CROWDED, IMPRECISE, KINDS
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.report import Json
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.execution.single import run
from hierax.runtime.launch.supervisor import launch
from hierax.runtime.loading.allowance import module_of
from hierax.runtime.watch.meter import EDGES, OBSERVE, PREDICT, Meter
from hierax.schemas.roster import ProbeSpec, Reference

DEPLOYMENT = "tracking"
# What is set of the deployment, by way. An object's own model is what it shows when no other object is there.
WAYS = {
    "own model": ("occlusion=false",),
    "context, no physics": ("physics=false",),
    "context, no prior": ("prior=false",),
    "with all": (),
}
CONTEXT, OWN = "with all", "own model"
SEARCH = "start=search"
STAGES = ("world", "arm", "spatial")  # nodes whose time is told; each with the edge functions that run in it
SPEED_KINDS = {1: "scattered", 5: "scattered", CROWD: CROWDED}  # by how many objects of them
Tell = Callable[[str], None]
GENERATOR_B = Path("benchmarks/generator_b")  # in a checkout; no part of the package, and nothing is fitted to it
_BELIEFS = "hierax.nodes.tracking.evaluation.calibration:Beliefs"


@dataclass(frozen=True)
class Generator:
    """A generator of scenes: the package's, or a program of its own, a Python file or a folder with ``__main__.py``,
    or what else is executable.
    ``PROGRAM --kinds`` prints the kinds of scenes that it makes, ``PROGRAM OUT --kind K --seed N --frames N [--exact]``
    writes one as `write_scene` does, and prints its folder. What fails raises `HieraxError`."""

    path: Path | None  # the program; None: the package's

    def kinds(self) -> list[str]:
        """Kinds of scenes that it makes."""
        return list(KINDS) if self.path is None else self._run("--kinds").split()

    def write(self, out: Path, kind: str, seed: int, frames: int, exact: bool) -> Path:
        """Write a scene; its folder."""
        if self.path is None:
            return write_scene(out, kind, seed, frames, exact)
        numbers = (f"--seed={seed}", f"--frames={frames}")
        return Path(self._run(str(out), f"--kind={kind}", *numbers, *(["--exact"] if exact else [])).strip())

    def _run(self, *arguments: str) -> str:
        done = subprocess.run([*self._program(), *arguments], capture_output=True, text=True, check=False)
        if done.returncode:
            last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise HieraxError(f"{self.path}: {last.removeprefix('error: ')}")
        return done.stdout

    def _program(self) -> list[str]:
        """What is executable is run as itself; Python files and folders, which may be executable, too, by Python."""
        path = Path(self.path or "").absolute()  # a bare name would be looked for in PATH
        by_itself = path.is_file() and path.suffix != ".py" and os.access(path, os.X_OK)
        return [str(path)] if by_itself else [sys.executable, str(path)]


def generator(name: str) -> Generator:
    """A generator of scenes: A, the package's; B, the checkout's, which is another hand's; or a program's path. Raises
    HieraxError: there is no such program."""
    path = {"A": None, "B": GENERATOR_B}.get(name, Path(name))
    if path is not None and not path.exists():
        hint = "; B is part of a checkout, to be run from there" if name == "B" else ""
        raise HieraxError(f"{path}: no such program; expected A, B or the path of a generator{hint}")
    return Generator(path)


@dataclass(frozen=True)
class Scene:
    """A scene to be tracked."""

    name: str  # what scenes are put together by: the kind, or the folder's name
    seed: int  # of a generated scene; 0 of others
    folder: Path  # of the BOP scene
    truth: Path  # the folder with the true poses
    table: bool  # whether the world's plane z = 0 carries the objects


@dataclass(frozen=True)
class Row:
    """All scenes of one name, tracked in one way."""

    name: str
    way: str
    score: Score  # of all objects of all the scenes
    stage_ms: dict[str, float]  # by node, the median of the scenes
    # of each scene, the share within 5 mm and 5° where more than half of an object is hidden; nan where nothing is
    hidden_shares: Sequence[float]

    def plain(self) -> dict[str, Json]:
        hidden = [None if np.isnan(share) else share for share in self.hidden_shares]
        told = {"stage_ms": self.stage_ms, "hidden_shares": hidden}
        return {"scene": self.name, "way": self.way, **self.score.plain(), **told}


@dataclass(frozen=True)
class Gain:
    """What context is worth on hidden objects: share within 5 mm and 5° with all, less that of own models."""

    name: str  # of the scenes
    differences: Sequence[float]  # one for each seed

    def plain(self) -> dict[str, Json]:
        """The gain as plain JSON; the spread is the standard deviation over the seeds."""
        known = np.array(self.differences)
        spread = float(known.std(ddof=1)) if len(known) > 1 else None
        mean, least, most = (float(figure) for figure in (known.mean(), known.min(), known.max()))
        return {"scene": self.name, "seeds": len(known), "mean": mean, "spread": spread, "least": least, "most": most}


@dataclass(frozen=True)
class Speed:
    """A launch over Zenoh."""

    objects: int  # how many there are
    rounds: Sequence[float]  # of each, epochs per second from the first epoch's beginning to the last one's commit
    stage_ms: dict[str, float]  # by node, the processor's time of an epoch, measured in one process

    @property
    def epochs_hz(self) -> float:
        """The median of the rounds."""
        return float(np.median(self.rounds))

    def plain(self) -> dict[str, Json]:
        return {**asdict(self), "epochs_hz": self.epochs_hz}


def generated(
    by: Generator, names: Sequence[str], seeds: int, frames: int, exact: bool, folder: Path, told: Tell
) -> list[Scene]:
    """Write scenes of these kinds, seeds from 0 on, as datasets into a folder; `exact`: start and camera are told as
    they are. Raises HieraxError: something cannot be written, or the generator failed."""
    scenes = []
    for name, seed in product(names, range(seeds)):
        told(f"{name}, seed {seed}: drawing {frames} frames")
        out = folder / f"{name}-{seed}{'-exact' if exact else ''}-{frames}"
        scene = by.write(out, name, seed, frames, exact)
        scenes.append(Scene(name, seed, scene, out / "truth" / scene.name, True))
    return scenes


def bench_tracking(
    scenes: Sequence[Scene], ways: Sequence[str], settings: Sequence[str], folder: Path, told: Tell
) -> list[Row]:
    """Track scenes in several of `WAYS`, with further settings ``path=value`` of the deployment; results files go into
    the folder, and what the arm believed. Raises HieraxError: a scene cannot be read, or a node failed."""
    tracked: dict[tuple[str, str], list[Tracked]] = {}
    for scene, way in product(scenes, ways):
        told(f"{scene.name}, seed {scene.seed}: {way}")
        tracked.setdefault((scene.name, way), []).append(track(scene, way, settings, folder))
    return [_row(name, way, of_scenes) for (name, way), of_scenes in tracked.items()]


def certainty(scenes: Sequence[Scene], ways: Sequence[str], folder: Path) -> Calibration | None:
    """How true is what the arm said of its certainty, with all; None where that was not tracked, or it said nothing.
    Where a model lies in its object cannot be said when it is imprecise: such scenes say nothing of it."""
    files = [folder / f"{_stem(scene, CONTEXT)}.beliefs.npz" for scene in scenes if scene.name != IMPRECISE]
    return calibration(files) if files and CONTEXT in ways and all(map(is_told, files)) else None


def gains(rows: Sequence[Row]) -> list[Gain]:
    """Context against own models, where both ways were tracked and something was hidden."""
    shares = {(row.name, row.way): np.array(row.hidden_shares) for row in rows}
    both = [name for name, way in shares if way == OWN and (name, CONTEXT) in shares]
    differences = {name: shares[name, CONTEXT] - shares[name, OWN] for name in both}
    known = {name: each[~np.isnan(each)].tolist() for name, each in differences.items()}
    return [Gain(name, each) for name, each in known.items() if each]


def bench_speed(frames: int, rounds: int, settings: Sequence[str], folder: Path, told: Tell) -> list[Speed]:
    """Launch the deployment over Zenoh in turn, each node a process, on scenes of one object and of several, with
    frames that are read from disk ahead of time. Raises HieraxError: a process failed."""
    deployments = {}
    for objects, kind in SPEED_KINDS.items():
        told(f"drawing {frames} frames with {objects} objects")
        scene = write_scene(folder / f"speed-{objects}", kind, 0, frames, False, objects)
        deployments[objects] = read_deployment(DEPLOYMENT, [f"scene={scene}", "table=true", *settings])
    rates: dict[int, list[float]] = {objects: [] for objects in SPEED_KINDS}
    for number, objects in product(range(rounds), SPEED_KINDS):
        told(f"{objects} objects, round {number + 1} of {rounds}")
        report = launch(deployments[objects], epochs=None, seed=0)
        rates[objects].append(report.epochs_per_s or 0.0)
    return [Speed(objects, rates[objects], _stages_ms(deployment)) for objects, deployment in deployments.items()]


def chosen(what: str, wanted: Sequence[str], known: Iterable[str]) -> list[str]:
    """Those of the known names that are wanted, in their order; all, where none are named. Raises HieraxError: there is
    no such name."""
    known = list(known)
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise HieraxError(f"there is no {what} {unknown[0]!r}; expected some of {', '.join(known)}")
    return [name for name in known if not wanted or name in wanted]


class Tracked(NamedTuple):
    """One scene, tracked in one way."""

    errors: Sequence[ObjectErrors]  # of each object, as scoring gives them
    stage_ms: dict[str, float]  # as `_stages_ms` gives them


def track(scene: Scene, way: str, settings: Sequence[str], folder: Path) -> Tracked:
    """Track a scene in one of the `WAYS`; arguments as for `bench_tracking`."""
    poses, beliefs = (folder / f"{_stem(scene, way)}.{kind}" for kind in ("poses.csv", "beliefs.npz"))
    changes = [f"scene={scene.folder}", f"table={str(scene.table).lower()}", f"output={poses}", *WAYS[way], *settings]
    truth = read_truth(scene.truth, posed=SEARCH not in settings)
    stage_ms = _stages_ms(_telling(read_deployment(DEPLOYMENT, changes), beliefs))
    judge(beliefs, truth)
    results = read_results(poses)
    frames = {result.im_id for result in results}
    if len(truth) == 1 < len(frames):
        raise HieraxError(
            f"{scene.truth}: has true poses of one frame; expected them of all {len(frames)} (--truth DIR)"
        )
    return Tracked(object_errors(results, truth, scene.name == IMPRECISE), stage_ms)


def _stem(scene: Scene, way: str) -> str:
    return f"{scene.name}-{scene.seed}-{way.replace(' ', '-').replace(',', '')}"


def _telling(deployment: Deployment, beliefs: Path) -> Deployment:
    """The deployment with a probe for what its arm believes."""
    probe = ProbeSpec("arm", Reference(_BELIEFS, {"file": str(beliefs)}))
    modules = (*deployment.modules, module_of(_BELIEFS))
    return replace(deployment, probes=(*deployment.probes, probe), modules=modules)


def _row(name: str, way: str, tracked: Sequence[Tracked]) -> Row:
    stages = {stage: float(np.median([each.stage_ms[stage] for each in tracked])) for stage in tracked[0].stage_ms}
    hidden = [score(each.errors).hidden.shares[1] for each in tracked]
    return Row(name, way, score([item for each in tracked for item in each.errors]), stages, hidden)


def _stages_ms(deployment: Deployment) -> dict[str, float]:
    """Run a deployment in this process; by node, an epoch's time in its operators and edge functions, in ms."""
    meters: dict[str, Meter] = {}

    def watch(name: str, runner: NodeRunner) -> None:
        # The time of this thread alone: other programs on the machine do not count.
        meters[name] = Meter(time.thread_time_ns)
        runner.watch(meters[name])

    run(deployment, epochs=None, seed=0, watch=watch)
    read = {name: meters[name].read() for name in STAGES if name in meters}
    work_ns = {name: sum(each["work_ns"][kind] for kind in (OBSERVE, PREDICT, EDGES)) for name, each in read.items()}
    return {name: float(work_ns[name] / max(1, each["epochs"]) / 1e6) for name, each in read.items()}
