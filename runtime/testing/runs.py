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
from hierax.runtime.testing.node import check_node
from hierax.runtime.transport.port import MemoryNetwork
from hierax.runtime.watch.watcher import Watcher


@dataclass(frozen=True)
class Ran:
    """A hierarchy after some epochs."""

    report: Report  # as the commands print it
    digests: Sequence[str]  # hexadecimal, of the first epoch, the second one, …
    steps: Mapping[str, Sequence[Step]]  # by node: what it was given and did in each epoch

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


def run_given(
    folder: Path,
    deployment: str | Path | None = None,
    *,
    nodes: Mapping[str, Node] | None = None,
    edges: Sequence[Edge] = (),
    world: str = "world",
    epochs: int | None = None,
    seed: int = 0,
    set: Mapping[str, Any] | None = None,
) -> Ran:
    """Run a deployment file, or nodes and edges made by the test.

    Args:
        folder: of the test.
        deployment: a file there or in the current folder, or the name of a shipped deployment.
        nodes, edges, world: in its place: nodes by name, the edges between them, and which one is N₀.
        epochs: how many; by default what the file says, or until the world has finished; of nodes, one.
        seed: of all random numbers, and of the order in which messages are delivered.
        set: changes of the file, as ``--set`` has them, by path.

    Raises:
        HieraxError: the file is wrong, the nodes form no hierarchy, or one failed.
    """
    if (deployment is None) == (nodes is None):
        raise TypeError("hierax_run: expected a deployment or nodes, one of them")
    if nodes is not None:
        return run_hierarchy(nodes, edges, world=world, epochs=1 if epochs is None else epochs, seed=seed)
    overrides = [f"{path}={json.dumps(value)}" for path, value in (set or {}).items()]
    read = read_deployment(found(folder, str(deployment)), overrides)
    extend_import_path(read.import_paths)
    kept = _Kept()
    return kept.ran(run(read, epochs=epochs, seed=seed, watch=kept.watch))


def found(folder: Path, file: str | Path) -> Path:
    """A file beside the test, else in the current folder."""
    return folder / file if (folder / file).is_file() else Path(file)


def run_node(node: Node, *, epochs: int | None = None, **given: Any) -> list[Step]:
    """Run a node by itself, and check it, as `check_node` does; by default for as many epochs as there are inputs."""
    longest = max(1, *(len(given.get(kind, ())) for kind in ("observations", "tasks", "context")))
    return check_node(node, epochs=longest if epochs is None else epochs, **given)


def run_hierarchy(
    nodes: Mapping[str, Node], edges: Sequence[Edge], *, world: str = "world", epochs: int = 1, seed: int = 0
) -> Ran:
    """Run nodes and edges that a test has made; `HieraxError` if they form no hierarchy, or a node failed."""
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


@dataclass(eq=False)
class _Keeper(Watcher):
    steps: list[Step]
    digests: list[str]

    def completed(self, completed: Completed) -> None:
        self.steps.append(completed.step)

    def committed(self, epoch: int, digest: bytes) -> None:
        self.digests.append(digest.hex())
