"""From the nodes' steps to what is on the canvas: the same for a run, a launch and a recording."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np
import yaml

from hierax.runtime.core.binding import metrics_of
from hierax.runtime.core.elements import Value
from hierax.runtime.core.graph import depths
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.showing import Graph, Things, colour_of, in_rows
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.viewing import views
from hierax.runtime.viewing.views import BELIEF, EPOCHS, HIERARCHY, TOGETHER, Kind, Placed, ShowError, View
from hierax.schemas.rates import Rates
from hierax.schemas.roster import Roster

Together = Callable[[Mapping[str, Step]], Things]
"""Shows what needs the steps of several nodes: of an epoch that all nodes have done, by name."""

EPOCHS_OPEN = 16  # how many epochs the nodes of a hierarchy may be apart until those that are late are not waited for
MOST_REACH = 256  # with rates, how many more at most, as one may be as far behind as its delays allow
TELL_AFTER_EPOCHS = 20  # after so many a view that nothing is shown in is taken for a slip of the layout
BELIEFS_KEPT = 4  # how many beliefs of each node are kept, as an epoch may be done again
_APART = (170.0, 110.0)  # between nodes in the picture of the hierarchy: across and up
MOST_LINES = 200  # how many lines one value takes at most; what is longer is cut off, and says so
MOST_ITEMS = 16  # how many items an array that is written out, or a list, has at most
MOST_CHARS, MOST_FIGURES = 80, 4


class Canvas:
    """Where things are drawn; this one draws nothing."""

    def draw(self, epoch: int, time_s: float, things: Iterable[Placed]) -> None:
        """Show things from an epoch on, in place of what was at their paths."""

    def clear(self, epoch: int, time_s: float, paths: Iterable[str]) -> None:
        """Show nothing at some paths from an epoch on."""

    def arrange(self, columns: tuple[views.Column, ...]) -> None:
        """Lay out the views."""


@dataclass
class _Epoch:
    time_s: float
    steps: dict[str, Step] = field(default_factory=dict)
    figures: dict[str, str] = field(default_factory=dict)


@dataclass(eq=False, repr=False)
class ViewPresenter:
    """Puts what nodes show on a canvas."""

    canvas: Canvas
    layout: views.Layout | None = None  # of the views; None: one by what they hold
    together: Together | None = None  # shows what needs several nodes; None: nothing
    notify: Callable[[str], None] = lambda _: None  # is given what the user should know, a line each

    def __post_init__(self) -> None:
        self._roster: Roster | None = None
        self._views: dict[str, View] = {}
        self._arranged: tuple[View, ...] = ()
        self._told = False
        self._shown: dict[str, frozenset[str]] = {}
        self._beliefs: dict[str, deque[tuple[int, Value]]] = {}
        self._figures: dict[str, str] = {}
        self._epochs: dict[int, _Epoch] = {}
        self._closed = self._whole = 0
        self._latest: dict[str, int] = {}  # by node, the epoch of its last step
        # with rates: by node, its last step up to the last epoch closed, and figures of that
        self._standing: dict[str, tuple[Step, str]] = {}

    def set_roster(self, roster: Roster) -> None:
        """The nodes and edges from now on."""
        self._roster = roster
        for name in (self._latest.keys() | self._figures.keys()) - roster.nodes.keys():
            self._figures.pop(name, None)
            self._latest.pop(name, None)
            self._standing.pop(name, None)

    def wants(self, name: str) -> bool:
        """Whether a node's steps are shown: others need not be built."""
        return True

    def step(self, name: str, node: Node, step: Step, start: Value = None) -> None:
        """Show what a node did, by its `show` and `metrics`, as `OperatorError` or `ShowError` says if that cannot be.
        `start` is the belief that the epoch began in, where that is known and no step before it was shown."""
        assert self._roster is not None, "the roster comes before its nodes' steps"
        if name not in self._roster.nodes:
            return  # it has gone meanwhile
        things = list(views.shown_by(name, node, step, self._before(name, step, start)))
        text = "```\n" + belief_text(step.belief) + "\n```"
        things.append(Placed(View(f"{name}/{BELIEF}", Kind.TEXT), f"{name}/{BELIEF}", name, text))
        self._show(name, step.epoch, step.time_s, things)
        self._gather(name, step, figures_text(metrics_of(name, node, step.belief, step.epoch)))

    def epoch_took(self, epoch: int, time_s: float, wall_s: float) -> None:
        """Show how many seconds an epoch took by the wall's clock, from its beginning to its commit."""
        view = View(EPOCHS, Kind.PLOT)
        self._show(EPOCHS, epoch, time_s, [Placed(view, f"{EPOCHS}/took_ms", "epoch, ms", 1000.0 * wall_s)])

    def close(self, *, is_whole: bool = True) -> None:
        """Show what is still open. Of a run that was broken off, which is not whole, nobody knows what would have been
        shown in a view that is empty."""
        for number in sorted(self._epochs):
            self._close(number)
        self._arrange()
        if is_whole:
            self._report_unknown()

    def _before(self, name: str, step: Step, start: Value) -> Value:
        """The belief that the epoch began in: that of the last one that the node has done."""
        kept = self._beliefs.setdefault(name, deque(maxlen=BELIEFS_KEPT))
        while kept and kept[-1][0] >= step.epoch:
            kept.pop()
        before = kept[-1][1] if kept else start
        kept.append((step.epoch, step.belief))
        return before

    def _show(self, source: str, epoch: int, time_s: float, things: Iterable[Placed]) -> None:
        """Draw what a source shows of an epoch, and nothing where it showed something and does no more."""
        things = list(things)
        for view in (thing.view for thing in things):
            known = self._views.setdefault(view.name, view)
            if known.kind is not view.kind:
                kinds = f"a {view.kind.value} as it holds a {known.kind.value}"
                raise ShowError(f"{source}: the view {view.name!r} cannot hold {kinds}")
        paths = frozenset(thing.path for thing in things)
        gone = self._shown.get(source, frozenset()) - paths
        if gone:
            self.canvas.clear(epoch, time_s, sorted(gone))
        self._shown[source] = paths
        self.canvas.draw(epoch, time_s, things)

    def _gather(self, name: str, step: Step, figures: str) -> None:
        """An epoch is closed when all nodes have done it, or are past it, or are far behind."""
        assert self._roster is not None
        rates = self._roster.rates
        self._figures[name] = figures
        number = step.epoch
        self._latest[name] = max(number, self._latest.get(name, 0))
        if number <= self._closed:
            return  # done again, or late
        epoch = self._epochs.setdefault(number, _Epoch(step.time_s))
        epoch.steps[name] = step
        epoch.figures[name] = figures
        kept = EPOCHS_OPEN if rates is None else EPOCHS_OPEN + min(rates.reach, MOST_REACH)
        for other in sorted(other for other in self._epochs if other <= number - kept):
            self._close(other)
        if rates is None:
            whole = [number] if epoch.steps.keys() >= self._roster.nodes.keys() else []
        else:
            whole = list(takewhile(partial(self._is_past, rates), sorted(self._epochs)))
        for other in whole:
            self._close(other)
            self._arrange()
            self._whole += 1
            if self._whole >= TELL_AFTER_EPOCHS:
                self._report_unknown()

    def _is_past(self, rates: Rates, number: int) -> bool:
        """Whether no node has a step of an epoch that has not come."""
        assert self._roster is not None
        latest = {name: self._latest.get(name, 0) for name in self._roster.nodes}
        return all(last >= number or rates.next_turn(name, last) > number for name, last in latest.items())

    def _close(self, number: int) -> None:
        assert self._roster is not None
        epoch = self._epochs.pop(number)
        self._closed = max(self._closed, number)
        for gone in [name for name in self._beliefs if name not in self._roster.nodes]:
            del self._beliefs[gone]
            self._show(gone, number, epoch.time_s, ())
        rates, steps, figures = self._roster.rates, epoch.steps, {**self._figures, **epoch.figures}
        if rates is not None:
            self._standing.update({name: (step, epoch.figures[name]) for name, step in steps.items()})
            steps = {name: step for name, (step, _) in self._standing.items()}
            figures = {
                name: f"{epochs_text(self._roster, name, step.epoch)}\n{text}".strip()
                for name, (step, text) in self._standing.items()
            }
        if self.together is not None and steps.keys() >= self._roster.nodes.keys():
            self._show(TOGETHER, number, epoch.time_s, self._shown_together(self.together, number, steps))
        graph = hierarchy_graph(self._roster, figures)
        self._show(HIERARCHY, number, epoch.time_s, [Placed(View(HIERARCHY, Kind.GRAPH), HIERARCHY, HIERARCHY, graph)])

    def _shown_together(self, together: Together, number: int, steps: Mapping[str, Step]) -> tuple[Placed, ...]:
        where = f"view.show in epoch {number}"
        try:
            things = together(dict(steps))
        except Exception as error:
            raise ShowError(f"{where}: {type(error).__name__}: {error}", "view.show") from error
        return views.placed(TOGETHER, things, where)

    def _report_unknown(self) -> None:
        """Say once which views of the layout nothing is shown in."""
        if not self._told:
            self._told = True
            for name in views.unknown_names(self._views, self.layout):
                self.notify(f"view.layout: nothing is shown in {name!r}{did_you_mean(name, self._views)}")

    def _arrange(self) -> None:
        """Lay out the views, where there are others than before: what the user has moved stays otherwise."""
        shown = tuple(self._views.values())
        if shown != self._arranged:
            self._arranged = shown
            self.canvas.arrange(views.arranged(self._views, self.layout))


def epochs_text(roster: Roster, name: str, epoch: int) -> str:
    """With rates: which epoch a node has done last, and which ones of those above counted in it, where others did."""
    rates = roster.rates or Rates()
    in_force = {upper: rates.in_force(name, upper, epoch) for upper in roster.above(name)}
    others = [f"{upper} {counts or '-'}" for upper, counts in in_force.items() if counts != epoch]
    return f"epoch {epoch}" + (f", with {', '.join(others)}" if others else "")


def hierarchy_graph(roster: Roster, figures: Mapping[str, str]) -> Graph:
    """The hierarchy, the world at the bottom, each node with some figures of its belief, if there is a text of them."""
    across, up = _APART
    places = in_rows(depths(roster.nodes, roster.pairs), across, -up)
    texts = {name: "\n".join(filter(None, (name, figures.get(name, "")))) for name in places}
    return Graph(texts, roster.pairs, places, {roster.world: colour_of(7)})


def belief_text(belief: Value) -> str:
    """A belief as an outline: a line for each part, large arrays by shape alone."""
    text = yaml.dump(_shown(belief), Dumper=_Outline, sort_keys=False, allow_unicode=True, width=10_000)
    lines = text.removesuffix("...\n").splitlines()
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], f"… {len(lines) - MOST_LINES} more lines"]
    return "\n".join(lines)


def figures_text(figures: Mapping[str, float]) -> str:
    """The first figures, a line each."""
    return "\n".join(f"{name} {number:.4g}" for name, number in list(figures.items())[:MOST_FIGURES])


class _Outline(yaml.SafeDumper):
    """Writes lists of numbers and texts in a line."""

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        flat = not any(isinstance(item, (dict, list)) for item in sequence)
        return super().represent_sequence(tag, sequence, flat)


def _shown(value: Value) -> Any:
    """What of a value is shown, of YAML's types."""
    if isinstance(value, Mapping):
        return {str(key): _shown(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.size > MOST_ITEMS:
        return f"{value.dtype} {' × '.join(map(str, value.shape))}"
    if isinstance(value, (np.ndarray, np.generic)):
        return _shown(value.tolist())
    if isinstance(value, (tuple, list)):
        more = [f"… {len(value) - MOST_ITEMS} more"] if len(value) > MOST_ITEMS else []
        return [*map(_shown, value[:MOST_ITEMS]), *more]
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, (bytes, bytearray, memoryview)):
        return f"{len(value)} bytes"
    if value is None or isinstance(value, (bool, int)):
        return value
    text = str(value)
    return text if len(text) <= MOST_CHARS else text[: MOST_CHARS - 1] + "…"
