"""Hierarchies and single nodes run by a test, with all that they did."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.difference import difference
from hierax.runtime.core.digest import NO_DIGEST, DigestChain
from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveNode, predict, sense
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.written import yaml_line_of
from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.report import Report
from hierax.runtime.execution.runner import NodeRunner, World
from hierax.runtime.execution.single import run
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_node, extend_import_path
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.loading.node_loader import wait_for
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import allowance_of
from hierax.runtime.recording.replayed_epoch import Exchange
from hierax.runtime.recording.trace import EpochTrace, taking_part
from hierax.runtime.testing.node import Input, check_epochs, check_node
from hierax.runtime.transport.port import MemoryNetwork
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.roster import Reference, Roster
from hierax.schemas.values import encode_value

Known = TypeVar("Known")


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
        HieraxError: the file is wrong, the nodes form no hierarchy, one failed, or no epoch is to be done.
        TypeError: what is given does not go together.
    """
    if (deployment is None) == (nodes is None):
        raise TypeError("hierax_run: expected a deployment or nodes, one of them")
    if nodes is not None and set:
        raise TypeError("hierax_run: set changes a deployment; expected nodes that are made as they are to be")
    if nodes is None and (edges or world != "world"):
        raise TypeError("hierax_run: edges and world go with nodes; a deployment has its own")
    check_epochs(epochs)
    if nodes is not None:
        return run_hierarchy(nodes, edges, world=world, epochs=1 if epochs is None else epochs, seed=seed)
    overrides = [f"{path}={_as_yaml(path, value)}" for path, value in (set or {}).items()]
    read = read_deployment(found(folder, str(deployment)), overrides)
    extend_import_path(read.import_paths)
    kept = _Kept()
    return kept.ran(run(read, epochs=epochs, seed=seed, watch=kept.watch))


def _as_yaml(path: str, value: Any) -> str:
    """A value as ``--set`` takes it. Raises `HieraxError` if YAML has none like it."""
    try:
        return yaml_line_of(value)
    except yaml.YAMLError as error:
        raise HieraxError(f"set {path}: expected text, numbers, lists or maps, got {value!r:.60}") from error


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
    times = (pacemaker.times.wall_s, pacemaker.times.took_s.numbers().tolist())
    return kept.ran(Report("test", "run", seed, chain.epoch, chain.digest.hex(), *times, reports))


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


@dataclass(frozen=True)
class Recorded:
    """A node in a recording."""

    name: str  # of the node
    reference: Reference  # its class and parameters
    below: tuple[str, ...]
    above: tuple[str, ...]
    seed: int  # of the run
    allowance: Allowance
    inputs: Sequence[Input]  # what it was given in each epoch
    start: ActiveNode = field(repr=False)  # its state before the first epoch
    states: Sequence[ActiveNode] = field(repr=False)  # after each of them

    @property
    def beliefs(self) -> list[Value]:
        """After each epoch, as recorded."""
        return [state.belief for state in self.states]

    def run(self, node: Node | None = None) -> list[Step]:
        """Do the epochs again with the recorded node, or another one; `HieraxError` if it cannot be, or failed."""
        made = build_node(self.reference, f"nodes.{self.name}", self.allowance) if node is None else node
        bound = BoundNode(self.name, made, self.below, self.above, OperatorSetting(self.seed, wait_for))
        state = self.start
        steps: list[Step] = []
        for epoch, time_s, observations, tasks, context in self.inputs:
            sensed = sense(bound, state, observations, epoch, time_s)
            state = predict(bound, sensed, tasks, context, epoch, time_s)
            done = (state.policy, state.actions, state.belief)
            steps.append(Step(epoch, 0, time_s, observations, sensed.belief, tasks, context, *done))
        return steps

    def check(self, node: Node | None = None) -> list[Step]:
        """Do the epochs again, as `run` does; `AssertionError` says in which one, and where, it is not as recorded."""
        steps = self.run(node)
        for step, state in zip(steps, self.states, strict=True):
            for what in ("policy", "actions", "belief"):
                then, now = getattr(state, what), getattr(step, what)
                if encode_value(then) != encode_value(now):
                    where = difference(then, now, where=what)
                    raise AssertionError(f"{self.name}: epoch {step.epoch} is not as recorded ({where})")
        return steps


def read_recorded(file: str | Path, name: str, epochs: int | None = None, trust: bool = False) -> Recorded:
    """The inputs of the node of a name in a recording. At most so many epochs are read; with `trust`, code that it
    names is loaded also where it is not known to be this user's own. Raises `HieraxError` if the file is no recording,
    is not trusted, has no such node, or lacks something that it was given, or no epoch is to be read."""
    check_epochs(epochs)
    recording = Recording.open(file)
    if not recording.info.how_stale.barrier:
        raise HieraxError(f"{file}: its epochs overlap; replay it by `hierax replay --node {name}`")
    allowance = allowance_of(recording, trust)
    extend_import_path(recording.info.import_paths)
    inputs: list[Input] = []
    states: list[ActiveNode] = []
    first: EpochTrace | None = None
    exchange = Exchange(barrier=True)
    for trace in recording.epochs():
        if name not in trace.roster.nodes:
            if first is None:
                continue  # it may be attached later
            break
        exchange.recall(trace)
        if name not in taking_part(trace.roster, trace.epoch):
            continue
        first = first or trace
        if _place(trace.roster, name) != _place(first.roster, name) or len(inputs) == epochs:
            break
        states.append(_known(file, trace, name, trace.state_of(name), "its state"))
        inputs.append(_input(exchange, trace, name))
    if first is None:
        names = {known for roster in recording.rosters().values() for known in roster.nodes}
        raise HieraxError(f"{file}: there is no node {name!r} in it{did_you_mean(name, names, 'the nodes are')}")
    reference, below, above = _place(first.roster, name)
    start = _known(file, first, name, first.start_of(name), "its state at the beginning")
    return Recorded(name, reference, below, above, recording.info.seed, allowance, inputs, start, states)


def _place(roster: Roster, name: str) -> tuple[Reference, tuple[str, ...], tuple[str, ...]]:
    return roster.nodes[name], roster.below(name), roster.above(name)


def _input(exchange: Exchange, trace: EpochTrace, name: str) -> Input:
    _, below, above = _place(trace.roster, name)
    tasking = [upper for upper in above if (name, upper) in trace.roster.tasking]
    lines = ((OBSERVATIONS, below), (TASKS, tasking), (CONTEXT, above))
    given = [exchange.elements(trace, kind, senders, name) for kind, senders in lines]
    return Input(trace.epoch, trace.nodes[name].step.time_s, *given)


def _known(file: str | Path, trace: EpochTrace, name: str, value: Known | None, what: str) -> Known:
    if value is None:
        raise HieraxError(f"{file}: {name}, epoch {trace.epoch}: {what} is not in the recording")
    return value
