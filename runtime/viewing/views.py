"""Which view a thing is seen in, and where it is in there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, get_args

import numpy as np

from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.showing import Curve, Graph, Picture, Scene, Thing

HIERARCHY, EPOCHS, BELIEF = "hierarchy", "epochs", "belief"
"""The views that the viewer itself fills, the last one for each node."""

TOGETHER = "together"
"""Who shows what is shown of several nodes together, in errors and paths."""


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


def shown_by(name: str, node: Node, step: Step, before: Value) -> tuple[Placed, ...]:
    """What a node shows of an epoch by `Node.show`. Raises `ShowError` if that raised, or gave something else."""
    try:
        things: Any = node.show(step, before)
    except Exception as error:
        raise ShowError(f"{name}: show in epoch {step.epoch}: {type(error).__name__}: {error}") from error
    return placed(name, things, f"{name}: show in epoch {step.epoch}")


def placed(name: str, things: Mapping[str, Thing], where: str) -> tuple[Placed, ...]:
    """Things by path, as the node of a name gives them by `Node.show`, in their places.

    Raises `ShowError`, which begins with `where`, if a path is wrong, or something is nothing that can be shown.
    """
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
