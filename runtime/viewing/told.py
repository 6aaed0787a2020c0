"""What one node shows in words and figures, for a terminal: pictures and scenes are for the viewer."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hierax.runtime.core.elements import Value
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.showing import Curve
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.viewing.presenter import Canvas, ViewPresenter
from hierax.runtime.viewing.recorded_run import show_recording
from hierax.runtime.viewing.views import Column, Kind, Placed, shown_by
from hierax.schemas.roster import Roster


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
    show_recording(recording, keeping, allowance, 1 if last is None else max(1, last - 1), last)
    roster, found = keeping.roster, keeping.found
    if roster is not None and name not in roster.nodes:
        raise RecordingError(f"{recording.path}: there is no node {name!r} in it{did_you_mean(name, roster.nodes)}")
    if roster is None or found is None or (epoch is not None and found.step.epoch != epoch):
        which = "any epoch" if epoch is None else f"epoch {epoch}"
        raise RecordingError(f"{recording.path}: what {name} did in {which} is not in it")
    return found, roster


class _Keeping(ViewPresenter):
    """Keeps what one node did last, and shows nothing."""

    def __init__(self, name: str) -> None:
        super().__init__(_Nothing())
        self._name = name
        self.found: Look | None = None
        self.roster: Roster | None = None

    def set_roster(self, roster: Roster) -> None:
        self.roster = roster

    def step(self, name: str, node: Node, step: Step, start: Value = None) -> None:
        if name == self._name:
            self.found = Look(name, node, step, self._before(name, step, start))


class _Nothing(Canvas):
    def draw(self, epoch: int, time_s: float, things: Iterable[Placed]) -> None:
        pass

    def clear(self, epoch: int, time_s: float, paths: Iterable[str]) -> None:
        pass

    def arrange(self, columns: tuple[Column, ...]) -> None:
        pass
