"""Where views stand on the screen: columns of cells, each of one view or of several behind tabs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hierax.runtime.viewing.views import EPOCHS, HIERARCHY, Kind, View

Cell = tuple[str, ...]
"""Names of views; more than one: behind tabs."""

Layout = tuple[tuple[Cell, ...], ...]
"""Columns from left to right, of cells from top to bottom."""

MOST_CELLS = 3
"""How many cells a column of the default layout has; more views share the last one."""


@dataclass(frozen=True)
class Column:
    """Cells of views from top to bottom, and their share of the screen's width, beside the other columns' shares."""

    cells: tuple[tuple[View, ...], ...]
    share: float


def arranged(views: Mapping[str, View], layout: Layout | None) -> tuple[Column, ...]:
    """Views in columns, as the deployment's layout has them, or, without one, by what they hold.

    Views that the layout does not name share a further cell at the end.
    """
    if layout is None:
        layout = default_layout(tuple(views.values()))
    columns = [[_known(cell, views) for cell in column] for column in layout]
    columns = [column for column in ([cell for cell in column if cell] for column in columns) if column]
    named = {view.name for column in columns for cell in column for view in cell}
    rest = tuple(view for name, view in views.items() if name not in named)
    if rest and columns:
        columns[-1].append(rest)
    elif rest:
        columns.append([rest])
    return tuple(Column(tuple(column), _share(column)) for column in columns)


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


def _known(cell: Cell, views: Mapping[str, View]) -> tuple[View, ...]:
    return tuple(views[name] for name in cell if name in views)


def _share(column: Sequence[Sequence[View]]) -> float:
    wide = any(view.kind in (Kind.PICTURE, Kind.SCENE) for cell in column for view in cell)
    return 3.0 if wide else 2.0
