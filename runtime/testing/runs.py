"""Hierarchies and single nodes run by a test, with all that they did."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import NO_DIGEST, DigestChain
from hierax.runtime.core.elements import Value
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.report import Report, make_report
from hierax.runtime.execution.runner import NodeRunner, World
from hierax.runtime.execution.single import run
from hierax.runtime.host.waiting import wait_for
from hierax.runtime.loading.loader import extend_import_path
from hierax.runtime.transport.memory import MemoryNetwork
from hierax.runtime.watch.watcher import Watcher


@dataclass(frozen=True)
class Ran:
    """A hierarchy after some epochs.

    Attributes:
        report: as the commands print it.
        digests: hexadecimal, of the first epoch, the second one, …
        steps: by node: what it was given and did in each epoch.
    """

    report: Report
    digests: Sequence[str]
    steps: Mapping[str, Sequence[Step]]

    @property
    def digest(self) -> str:
        """The digest of the last epoch: two runs with the same one were the same."""
        return self.report.digest

    @property
    def beliefs(self) -> dict[str, Value]:
        """The beliefs by node, after the last epoch."""
        return {name: node.belief for name, node in self.report.nodes.items()}

    @property
    def metrics(self) -> dict[str, dict[str, float]]:
        """The metrics by node, after the last epoch."""
        return {name: dict(node.metrics) for name, node in self.report.nodes.items()}

    def history(self, node: str) -> list[Value]:
        """A node's beliefs after the first epoch, the second one, …"""
        return [step.belief for step in self.steps[node]]


def run_deployment(
    file: str | Path, *, epochs: int | None = None, seed: int = 0, settings: Mapping[str, Any] | None = None
) -> Ran:
    """Run a deployment file, or the shipped deployment of a name, in this process.

    Args:
        epochs: how many; None: what the file says, or until the world has finished.
        seed: of all random numbers, and of the order of delivery.
        settings: as ``--set`` has them, by path.

    Raises:
        HieraxError: the file is wrong, or a node failed.
    """
    overrides = [f"{path}={json.dumps(value)}" for path, value in (settings or {}).items()]
    deployment = read_deployment(file, overrides)
    extend_import_path(deployment.import_paths)
    kept = _Kept()
    report = run(deployment, epochs=epochs, seed=seed, watch=kept.watch)
    return kept.ran(report)


def run_hierarchy(
    nodes: Mapping[str, Node], edges: Sequence[Edge], *, world: str = "world", epochs: int = 1, seed: int = 0
) -> Ran:
    """Run nodes, by name, and edges (`hierax.runtime.core.hierarchy.Edge`, with functions) that a test has made.

    Args:
        world: the name of N₀.
        epochs: how many at most; fewer where the world has finished.
        seed: as `run_deployment` has it.

    Raises:
        HieraxError: they form no hierarchy, or a node failed.
    """
    hierarchy = Hierarchy(nodes, world, edges, OperatorSetting(seed, wait_for))
    network = MemoryNetwork(seed)
    kept = _Kept()
    pacemaker = Pacemaker(DigestChain(NO_DIGEST), epochs, lambda epoch, digest: None)
    place = Place(tasking=frozenset(edge.pair for edge in edges if edge.task is not None))
    runners: dict[str, NodeRunner] = {}
    for name, bound in hierarchy.bound.items():
        its_edges = [edge for pair, edge in hierarchy.bound_edges.items() if name in pair]
        wiring = Wiring(bound, its_edges, place)
        begins = World(pacemaker) if name == world else None
        runners[name] = NodeRunner(wiring, network.open_port(name), world=begins)
        kept.watch(name, runners[name])
    runners[world].finish()
    while (receiver := network.next_receiver()) is not None:
        message = runners[receiver].port.receive()
        if message is not None:
            runners[receiver].step(message)
    reports = {name: runner.report() for name, runner in runners.items()}
    chain = pacemaker.chain
    return kept.ran(
        make_report("test", "run", seed, chain.epoch, chain.digest, pacemaker.wall_s, list(pacemaker.epochs_s), reports)
    )


@dataclass
class _Kept:
    """What the nodes of a run did."""

    steps: dict[str, list[Step]] = field(default_factory=dict)
    digests: list[str] = field(default_factory=list)

    def watch(self, name: str, runner: NodeRunner) -> None:
        runner.watch(_Keeper(self.steps.setdefault(name, []), self.digests))

    def ran(self, report: Report) -> Ran:
        return Ran(report, tuple(self.digests), {name: tuple(steps) for name, steps in sorted(self.steps.items())})


class _Keeper(Watcher):
    def __init__(self, steps: list[Step], digests: list[str]) -> None:
        self._steps = steps
        self._digests = digests

    def completed(self, completed: Completed) -> None:
        self._steps.append(completed.step)

    def committed(self, epoch: int, digest: bytes) -> None:
        self._digests.append(digest.hex())
