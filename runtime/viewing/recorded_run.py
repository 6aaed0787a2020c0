"""Seeing a recording."""

from __future__ import annotations

from itertools import chain

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.hierarchy import neighbours_above, neighbours_below
from hierax.runtime.core.probe import Step
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replayed_epoch import Exchange
from hierax.runtime.recording.trace import EpochTrace
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.viewing.views import ShownNodes
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS


def show_recording(
    recording: Recording, presenter: ViewPresenter, allowance: Allowance, first: int = 1, last: int | None = None
) -> int:
    """Show the epochs of a recording from the first to the last one; how many were shown. Raises `HieraxError` if the
    file is damaged, a node cannot or may not be loaded, or what it shows cannot be shown."""
    playing = _Playing(presenter, allowance, Exchange(recording.info.how_stale.barrier))
    shown = 0
    for trace in recording.epochs(first, last):
        playing.epoch(trace)
        shown += 1
    presenter.close()
    return shown


class _Playing:
    """Makes steps of a recording's epochs."""

    def __init__(self, presenter: ViewPresenter, allowance: Allowance, exchange: Exchange) -> None:
        self._presenter = presenter
        self._exchange = exchange
        self._nodes = ShownNodes(allowance)
        self._beliefs: dict[str, tuple[int, Value]] = {}
        self._committed = (0, 0)

    def epoch(self, trace: EpochTrace) -> None:
        """Show an epoch."""
        self._presenter.set_roster(trace.roster)
        self._exchange.recall(trace)
        epoch, heard_ns = self._committed
        self._committed = (trace.epoch, trace.heard_ns)
        if epoch == trace.epoch - 1 and heard_ns and trace.heard_ns and trace.time_s is not None:
            self._presenter.epoch_took(trace.epoch, trace.time_s, (trace.heard_ns - heard_ns) / 1e9)
        for name in trace.order:
            self._node(trace, name)

    def _node(self, trace: EpochTrace, name: str) -> None:
        known = trace.nodes.get(name)
        state, start = trace.state_of(name), trace.start_of(name)
        if known is None or state is None:
            return  # its process died before it could tell
        epoch, before = self._beliefs.get(name, (0, None))
        if start is not None or epoch >= trace.epoch:
            before = None if start is None else start.belief
        self._beliefs[name] = (trace.epoch, state.belief)
        sensed = trace.sensed_of(name)
        if sensed is None and name == trace.roster.world:
            sensed = None if before is None else (before,)  # the world senses nothing
        if sensed is None:
            return
        pairs = [edge.pair for edge in trace.roster.edges]
        below, above = neighbours_below(name, pairs), neighbours_above(name, pairs)
        lines = ((OBSERVATIONS, below), (TASKS, above), (CONTEXT, above))
        observations, tasks, context = (self._inputs(trace, name, kind, senders) for kind, senders in lines)
        done = (tasks, context, state.policy, state.actions, state.belief)
        step = Step(trace.epoch, trace.attempt, known.step.time_s, observations, sensed[0], *done)
        self._presenter.step(name, self._nodes.node(trace.roster, name), step, before)

    def _inputs(self, trace: EpochTrace, name: str, kind: str, senders: tuple[str, ...]) -> Elements:
        """What a node was given along all edges, in the order of their other ends' names; what lacks is left out."""
        found = (self._exchange.given(trace, (kind, sender, name)) for sender in senders)
        return tuple(chain.from_iterable(each.elements for each in found if each is not None))
