"""One node on the inputs that it had in a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.difference import difference
from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.hierarchy import neighbours_above, neighbours_below
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveNode, predict, sense
from hierax.runtime.host.waiting import wait_for
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_node, extend_import_path
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.deployments import allowance_of
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replayed_epoch import Exchange
from hierax.runtime.recording.trace import EpochTrace
from hierax.runtime.testing.node import Input
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.roster import Reference, Roster
from hierax.schemas.values import encode_value

Known = TypeVar("Known")


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
    is not trusted, has no such node, or lacks something that it was given."""
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
    pairs = [edge.pair for edge in roster.edges]
    return roster.nodes[name], neighbours_below(name, pairs), neighbours_above(name, pairs)


def _input(exchange: Exchange, trace: EpochTrace, name: str) -> Input:
    _, below, above = _place(trace.roster, name)
    tasking = {edge.upper for edge in trace.roster.edges if edge.task is not None and edge.lower == name}
    lines = ((OBSERVATIONS, below), (TASKS, [upper for upper in above if upper in tasking]), (CONTEXT, above))
    exchange.recall(trace)
    given = [exchange.elements(trace, kind, senders, name) for kind, senders in lines]
    return Input(trace.epoch, trace.nodes[name].step.time_s, *given)


def _known(file: str | Path, trace: EpochTrace, name: str, value: Known | None, what: str) -> Known:
    if value is None:
        raise HieraxError(f"{file}: {name}, epoch {trace.epoch}: {what} is not in the recording")
    return value
