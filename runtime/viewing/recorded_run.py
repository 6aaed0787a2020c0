"""Seeing a recording, and what one node shows in words and figures, for a terminal."""

from dataclasses import dataclass
from itertools import chain

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.showing import Curve
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replayed_epoch import Exchange
from hierax.runtime.recording.trace import EpochTrace
from hierax.runtime.viewing.presenter import Canvas, ViewPresenter
from hierax.runtime.viewing.views import Kind, ShownNodes, shown_by
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.roster import Roster


def show_recording(
    recording: Recording, presenter: ViewPresenter, allowance: Allowance, first: int = 1, last: int | None = None
) -> int:
    """Show the epochs of a recording from the first to the last one; how many were shown. Raises `HieraxError` if the
    file is damaged, a node cannot or may not be loaded, or what it shows cannot be shown."""
    playing = _Playing(presenter, allowance, Exchange(recording.info.how_stale.barrier))
    shown = 0
    for trace in recording.epochs(last=last):
        playing.recall(trace)
        if trace.epoch >= first:
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

    def recall(self, trace: EpochTrace) -> None:
        """Have what was said in an epoch, which may count later, too."""
        self._exchange.recall(trace)

    def epoch(self, trace: EpochTrace) -> None:
        """Show an epoch that was recalled."""
        self._presenter.set_roster(trace.roster)
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
        if not self._presenter.wants(name):
            return
        sensed = trace.sensed_of(name)
        if sensed is None and name == trace.roster.world:
            sensed = None if before is None else (before,)  # the world senses nothing
        if sensed is None:
            return
        below, above = trace.roster.below(name), trace.roster.above(name)
        inputs: list[Elements] = []  # along all edges, in the order of their other ends' names; what lacks is left out
        for kind, senders in ((OBSERVATIONS, below), (TASKS, above), (CONTEXT, above)):
            found = (self._exchange.given(trace, (kind, sender, name)) for sender in senders)
            inputs.append(tuple(chain.from_iterable(each.elements for each in found if each is not None)))
        observations, tasks, context = inputs
        done = (tasks, context, state.policy, state.actions, state.belief)
        step = Step(trace.epoch, trace.attempt, known.step.time_s, observations, sensed[0], *done)
        self._presenter.step(name, self._nodes.node(trace.roster, name), step, before)


@dataclass(frozen=True)
class Look:
    """What a node did in an epoch."""

    name: str
    node: Node  # whose `show` is called
    step: Step
    before: Value  # the belief that the epoch began in; None where it is not known

    def told(self) -> dict[str, dict[str, str | float]]:
        """Texts and figures by view and label. Raises `ShowError` if it cannot be shown."""
        told: dict[str, dict[str, str | float]] = {}
        for each in shown_by(self.name, self.node, self.step, self.before):
            view = told.setdefault(each.view.name.removeprefix(f"{self.name}/"), {})
            if isinstance(each.thing, str):
                view[each.label] = each.thing
            elif each.view.kind is Kind.PLOT:
                view[each.label] = float(each.thing.value if isinstance(each.thing, Curve) else each.thing)  # type: ignore[arg-type]
        return {name: view for name, view in told.items() if view}


def recorded_look(recording: Recording, name: str, epoch: int | None, allowance: Allowance) -> tuple[Look, Roster]:
    """What a node did in an epoch of a recording, by default the last one, and the roster then. Raises `HieraxError` if
    it is not in the recording, the file is damaged, or a node cannot or may not be loaded."""
    last = recording.ending.last if epoch is None and recording.ending is not None else epoch
    keeping = _Keeping(name)
    first = 1  # where epochs overlap, a node may have left out any number of those before the last one
    if recording.info.how_stale.barrier and last is not None:
        rates = [roster.rates for roster in recording.rosters().values() if roster.rates is not None]
        first = max(1, last - max((each.reach for each in rates), default=1))
    show_recording(recording, keeping, allowance, first, last)
    roster, found = keeping.roster, keeping.found
    if roster is not None and name not in roster.nodes:
        raise RecordingError(f"{recording.path}: {_absent(recording, roster, name)}")
    if roster is None or found is None or (epoch is not None and found.step.epoch != epoch):
        which = "any epoch" if epoch is None else f"epoch {epoch}"
        before = "" if found is None else f"; it took part in epoch {found.step.epoch} last before that"
        raise RecordingError(f"{recording.path}: what {name} did in {which} is not in it{before}")
    return found, roster


def _absent(recording: Recording, roster: Roster, name: str) -> str:
    """That a roster has no node of a name, and when there was one."""
    did = [step.epoch for step in recording.steps(name)]
    if not did:
        return f"there is no node {name!r} in it{did_you_mean(name, roster.nodes)}"
    return f"there is no node {name!r} in that epoch; it took part from epoch {min(did)} to {max(did)}: give --epoch"


class _Keeping(ViewPresenter):
    """Keeps what one node did last, and shows nothing."""

    def __init__(self, name: str) -> None:
        super().__init__(Canvas())
        self._name = name
        self.found: Look | None = None
        self.roster: Roster | None = None

    def set_roster(self, roster: Roster) -> None:
        self.roster = roster

    def wants(self, name: str) -> bool:
        return name == self._name

    def step(self, name: str, node: Node, step: Step, start: Value = None) -> None:
        self.found = Look(name, node, step, self._before(name, step, start))
