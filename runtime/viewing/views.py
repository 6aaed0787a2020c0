"""Which view a thing is seen in, where it is in there, and where views stand on the screen.

That is in columns of cells, each of one view or of several behind tabs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, get_args

import numpy as np

from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import FAILURES, HieraxError
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.showing import Curve, Graph, Picture, Scene, Thing
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_node
from hierax.schemas.roster import Roster
from hierax.schemas.values import encode_value

HIERARCHY, EPOCHS, BELIEF = "hierarchy", "epochs", "belief"
"""The views that the viewer itself fills, the last one for each node."""

TOGETHER = "together"  # who shows what is shown of several nodes together, in errors and paths

Cell = tuple[str, ...]  # names of views; more than one: behind tabs
Layout = tuple[tuple[Cell, ...], ...]  # columns from left to right, of cells from top to bottom
MOST_CELLS = 3  # how many cells a column of the default layout has; more views share the last one


class ShowError(HieraxError):
    """What a node shows cannot be shown; `where` is the path in the deployment file of what shows it, or empty."""

    def __init__(self, message: str, where: str = "") -> None:
        self.where = where
        super().__init__(message)


class Kind(Enum):
    """What a view holds."""

    PICTURE = "picture"
    SCENE = "scene"
    PLOT = "plot"
    TEXT = "text"
    GRAPH = "graph"


@dataclass(frozen=True)
class View:
    """A view, and what it holds; its name, ``scene`` or ``NODE/score``, is the path of all that is in it, too."""

    name: str
    kind: Kind


@dataclass(frozen=True)
class Placed:
    """A thing in the view in which it is seen, by a path that no other thing of a node has, and its label there."""

    view: View
    path: str
    label: str
    thing: Thing


class ShownNodes:
    """Builds the nodes that may be loaded; one whose class and parameters stay is kept."""

    def __init__(self, allowance: Allowance) -> None:
        self._allowance = allowance
        self._built: dict[str, tuple[bytes, Node]] = {}

    def node(self, roster: Roster, name: str) -> Node:
        """A node of a roster. Raises `NotAllowedError` or `LoadError` if it may not, or cannot, be loaded."""
        reference = roster.nodes[name]
        key = encode_value(reference.plain())
        if name not in self._built or self._built[name][0] != key:
            self._built[name] = (key, build_node(reference, f"nodes.{name}", self._allowance, name == roster.world))
        return self._built[name][1]


def shown_by(name: str, node: Node, step: Step, before: Value) -> tuple[Placed, ...]:
    """What a node shows of an epoch by `Node.show`. Raises `ShowError` if that raised, or gave something else."""
    try:
        things: Any = node.show(step, before)
    except FAILURES as error:
        raise ShowError(f"{name}: show in epoch {step.epoch}: {type(error).__name__}: {error}") from error
    return placed(name, things, f"{name}: show in epoch {step.epoch}")


def placed(name: str, things: Mapping[str, Thing], where: str) -> tuple[Placed, ...]:
    """Things by path, as the node of a name gives them by `Node.show`, in their places. Raises `ShowError`, which
    begins with `where`, if a path is wrong, or something is nothing that can be shown."""
    if not isinstance(things, Mapping):
        raise ShowError(f"{where}: expected things by path, got {type(things).__name__}")
    return tuple(_place(name, path, thing, where) for path, thing in things.items())


def _place(name: str, path: str, thing: Thing, where: str) -> Placed:
    parts = path.split("/") if isinstance(path, str) else []
    shared = bool(parts) and not parts[0]
    inside = parts[1:] if shared else parts
    if not inside or not all(inside):
        raise ShowError(f"{where}: {path!r:.80} is no path: expected 'view/thing' or '/view/thing'")
    if inside[0] == (HIERARCHY if shared else BELIEF):
        raise ShowError(f"{where}: {path}: the view {inside[0]!r} is the viewer's own")
    kind = next((kind for kind, types in _KINDS.items() if isinstance(thing, types)), None)
    if kind is None:
        expected = "expected a number, a text or a thing of hierax.runtime.core.showing"
        raise ShowError(f"{where}: {path}: {expected}, got {type(thing).__name__}")
    view, label = inside[0], "/".join(inside[1:])
    if shared:
        return Placed(View(view, kind), "/".join((view, name, *inside[1:])), label or name, thing)
    return Placed(View(f"{name}/{view}", kind), "/".join((name, *inside)), label or view, thing)


_KINDS: dict[Kind, tuple[type, ...]] = {
    Kind.PLOT: (bool, int, float, np.number, np.bool_, Curve),
    Kind.TEXT: (str,),
    Kind.PICTURE: get_args(Picture),
    Kind.SCENE: get_args(Scene),
    Kind.GRAPH: (Graph,),
}
"""What each kind of view holds."""


@dataclass(frozen=True)
class Column:
    """Cells of views from top to bottom, and their share of the screen's width, beside the other columns' shares."""

    cells: tuple[tuple[View, ...], ...]
    share: float


def arranged(views: Mapping[str, View], layout: Layout | None) -> tuple[Column, ...]:
    """Views in columns, by the layout, or by what they hold; those that it does not name share a further, last cell."""
    if layout is None:
        layout = default_layout(tuple(views.values()))
    columns = [[tuple(views[name] for name in cell if name in views) for cell in column] for column in layout]
    columns = [column for column in ([cell for cell in column if cell] for column in columns) if column]
    named = {view.name for column in columns for cell in column for view in cell}
    rest = tuple(view for name, view in views.items() if name not in named)
    if rest:
        columns = columns or [[]]
        columns[-1].append(rest)
    wide = (Kind.PICTURE, Kind.SCENE)
    shares = [3.0 if any(view.kind in wide for cell in column for view in cell) else 2.0 for column in columns]
    return tuple(map(Column, map(tuple, columns), shares))


def unknown_names(views: Mapping[str, View], layout: Layout | None) -> tuple[str, ...]:
    """The names in a layout that no view has."""
    names = [name for column in layout or () for cell in column for name in cell]
    return tuple(name for name in names if name not in views)


def default_layout(views: Sequence[View]) -> Layout:
    """Pictures to the left, then scenes, then curves, then the hierarchy and what each node believes."""

    def of(*kinds: Kind) -> list[str]:
        return [view.name for view in views if view.kind in kinds and view.name not in (HIERARCHY, EPOCHS)]

    pictures, scenes, plots = of(Kind.PICTURE), of(Kind.SCENE, Kind.GRAPH), of(Kind.PLOT)
    last = [(HIERARCHY,), tuple(of(Kind.TEXT)), (EPOCHS,)]
    columns = [_stacked(names) for names in (pictures, scenes, plots) if names]
    return (*columns, tuple(last))


def _stacked(names: Sequence[str]) -> tuple[Cell, ...]:
    first = tuple((name,) for name in names[: MOST_CELLS - 1])
    rest = tuple(names[MOST_CELLS - 1 :])
    return (*first, rest) if rest else first
