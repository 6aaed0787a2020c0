"""A canvas that keeps what is drawn on it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from hierax.runtime.viewing.presenter import Canvas
from hierax.runtime.viewing.views import Column, Placed


class KeptCanvas(Canvas):
    """Keeps all of it.

    Attributes:
        drawn: things by epoch, then by path.
        cleared: paths by epoch.
        layouts: each that was wanted.
    """

    def __init__(self) -> None:
        self.drawn: dict[int, dict[str, Placed]] = {}
        self.cleared: dict[int, list[str]] = {}
        self.layouts: list[tuple[Column, ...]] = []

    def draw(self, epoch: int, time_s: float, things: Iterable[Placed]) -> None:
        self.drawn.setdefault(epoch, {}).update({each.path: each for each in things})

    def clear(self, epoch: int, time_s: float, paths: Iterable[str]) -> None:
        self.cleared.setdefault(epoch, []).extend(paths)

    def arrange(self, columns: tuple[Column, ...]) -> None:
        self.layouts.append(columns)

    @property
    def names(self) -> list[list[list[str]]]:
        """The names of the views in the last layout: columns of cells."""
        return [[[view.name for view in cell] for cell in column.cells] for column in self.layouts[-1]]

    def plain(self, without: str = "epochs/") -> dict[int, dict[str, Any]]:
        """All that was drawn, to be compared; times are left out."""
        return {
            epoch: {path: plain_thing(each.thing) for path, each in sorted(things.items()) if without not in path}
            for epoch, things in sorted(self.drawn.items())
        }


def plain_thing(thing: Any) -> Any:
    """A thing as what can be compared."""
    if is_dataclass(thing) and not isinstance(thing, type):
        return (type(thing).__name__, *(plain_thing(getattr(thing, each.name)) for each in fields(thing)))
    return (thing.dtype.str, thing.shape, thing.tobytes()) if isinstance(thing, np.ndarray) else thing
