"""Random hierarchies in random processes, of which one is killed: the digest is that of a run in one process."""

from __future__ import annotations

import os
import random
import signal
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from hierax.runtime.deployment.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run
from hierax.runtime.launch.supervisor import launch
from hierax.runtime.sim.rated import draw_rates
from support.launched import is_alive

EPOCHS = 60
WAIT_S = 60.0
MIXING = "hierax.runtime.sim.nodes"
SAID = "; it is started again"


@dataclass
class Outcome:
    """What a launch with a kill has come to.

    Attributes:
        digest: its last one.
        wanted: that of the run in one process.
        nodes: how many there are.
        processes: by name, the nodes that share one.
        killed: the nodes that were killed together; none where the launch was over before.
        said: what was said of processes.
        reports: the nodes that reported in the end.
    """

    digest: str
    wanted: str
    nodes: int
    processes: Mapping[str, Sequence[str]]
    killed: Sequence[str]
    said: list[str]
    reports: set[str]

    @property
    def restarts(self) -> int:
        """How many processes were started in the place of others."""
        return sum(SAID in line for line in self.said)

    @property
    def fault(self) -> str:
        """What is not as it is to be; empty: nothing. A process that is killed as it leaves is not started again."""
        if self.digest != self.wanted:
            return f"digest {self.digest}, not {self.wanted}: {self.said}"
        if self.restarts > bool(self.killed):
            return f"of {list(self.killed)}, killed with one process, {self.restarts} were started again: {self.said}"
        return "" if len(self.reports) == self.nodes else f"reports of {sorted(self.reports)} alone"


def random_deployment(rng: random.Random) -> dict[str, Any]:
    """Nodes whose every result depends on every input and on random numbers; 2 to 12 of them."""
    names = ["world", *(f"n{number:02}" for number in range(1, rng.randint(2, 12)))]
    nodes: dict[str, Any] = {
        name: {
            "class": f"{MIXING}:{rng.choice(('Mixer', 'Drawer')) if number else 'MixingWorld'}",
            "parameters": {"name": name, "policies": rng.randint(1, 3)},
        }
        for number, name in enumerate(names)
    }
    edges: dict[str, Any] = {}
    for place, name in enumerate(names[1:], 1):
        for lower in rng.sample(names[:place], rng.randint(1, min(place, 3))):
            edges[f"{lower} -> {name}"] = {
                kind: {
                    "function": f"{MIXING}:{rng.choice(('Mix', 'DrawingMix'))}",
                    "parameters": {"name": f"{lower}-{name}-{kind}"},
                }
                for kind in ("sense", "task", "context")
                if rng.random() < 0.8
            }
    return {"hierarchy": "partitioned", "world": "world", "nodes": nodes, "edges": edges}


def with_rates(rng: random.Random, plain: dict[str, Any]) -> dict[str, Any]:
    """The same, of which nodes take part now and then, edges have delays, and some gather."""
    nodes, edges = plain["nodes"], plain["edges"]
    pairs = {(lower, upper): edge for edge in edges for lower, upper in [edge.split(" -> ")]}
    sensed = [pair for pair, edge in pairs.items() if "sense" in edges[edge]]
    rates = draw_rates(rng, [name for name in nodes if name != plain["world"]], list(pairs), sensed)
    for name, turns in rates.turns.items():
        nodes[name] |= {"every": turns.every, "offset": turns.offset}
    for pair, delay in rates.delays.items():
        edges[pairs[pair]]["delay"] = delay
    for pair in rates.gathers:
        edges[pairs[pair]]["gather"] = True
    return plain


def random_partition(rng: random.Random, names: Sequence[str]) -> dict[str, list[str]]:
    """Any nodes in any processes: from each in its own to all in one."""
    count = rng.choice((1, 2, 3, len(names)))
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(f"p{rng.randrange(count)}", []).append(name)
    return groups


def outcome_of(seed: int, epochs: int = EPOCHS, at: int | None = None, rated: bool = False) -> Outcome:
    """Launch the hierarchy and partition of a seed, kill one of its processes, and run it in one.

    Args:
        seed: of all that is random.
        epochs: how many.
        at: after which epoch; None: at random.
        rated: whether nodes have rates, and edges delays.
    """
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plain = random_deployment(rng)
        if rated:
            with_rates(rng, plain)
        plain["processes"] = random_partition(rng, list(plain["nodes"]))
        file = folder / "partitioned.yaml"
        file.write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
        deployment = read_deployment(file)
        wanted = run(deployment, epochs=epochs, seed=seed).digest
        said: list[str] = []
        victim = _Victim(rng, deployment, folder / "state", epochs, at)
        report = launch(
            deployment,
            epochs=epochs,
            seed=seed,
            progress=victim.progress,
            notify=said.append,
            state=folder / "state",
            broken=threading.Event(),
        )
        victim.over.set()
        victim.thread.join()
    return Outcome(
        report.digest, wanted, len(plain["nodes"]), deployment.processes, victim.killed, said, set(report.nodes)
    )


def _drawn(rng: random.Random, epochs: int) -> int:
    """After which epoch a process is killed; 0: at once."""
    drawn = rng.random()
    return 0 if drawn < 0.2 else epochs - 1 if drawn < 0.3 else rng.randint(1, epochs // 3)


class _Victim:
    """Kills the process of a node at an epoch; a fifth of all times from its first instant on, and a tenth as the last
    epoch comes, where the run may be over before anybody has said so."""

    def __init__(self, rng: random.Random, deployment: Deployment, state: Path, epochs: int, at: int | None) -> None:
        self._node = rng.choice(sorted(deployment.roster.nodes))
        self._lock = state / f"{self._node}.lock"
        self._epoch = _drawn(rng, epochs) if at is None else at
        self._delay_s = 0.004 * rng.random()
        self._mates = next(names for names in deployment.processes.values() if self._node in names)
        self._reached = threading.Event()
        self.over = threading.Event()
        self.killed: Sequence[str] = ()
        self.thread = threading.Thread(target=self._kill, daemon=True)
        self.thread.start()

    def progress(self, epoch: int, digest: bytes) -> None:
        """An epoch is committed."""
        if epoch >= self._epoch:
            self._reached.set()

    def _kill(self) -> None:
        patience_s = time.monotonic() + WAIT_S
        if self._epoch:
            self._reached.wait(WAIT_S)
        while not self.over.is_set() and time.monotonic() < patience_s:
            pid = self._pid()
            if pid and self._killed(pid):
                self.killed = self._mates
                return
            time.sleep(0.0005)

    def _killed(self, pid: int) -> bool:
        time.sleep(self._delay_s)
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:  # it has left by itself, as the run has ended or its nodes are in another one now
            return False
        return True

    def _pid(self) -> int:
        try:
            pid = int(self._lock.read_text())
        except (FileNotFoundError, ValueError):
            return 0
        return pid if is_alive(pid) else 0
