"""Methods of nodes whose names are nearly those of operators: Python takes them for something else, in silence."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from difflib import SequenceMatcher

from hierax.runtime.core.node import Node, World

NEAR = 0.8
"""How alike two names are, from 0 to 1, of which one is taken for the other misspelt."""


def misspelt_operators(given: type) -> list[str]:
    """What is wrong with the names of a node class's methods, a line for each.

    A public method counts that overrides nothing and whose name is near that of an operator which
    the class does not define either; a helper beside the operator that it is named after is none.
    """
    base: type = World if issubclass(given, World) else Node
    operators = [name for name, _ in _methods(base)]
    left_out = [name for name in operators if getattr(given, name) is getattr(base, name)]
    found = []
    for name, defined in _methods(given):
        near = [] if name in operators else [each for each in left_out if _alike(name, each) >= NEAR]
        if near:
            meant = max(near, key=lambda each: _alike(name, each))
            found.append(
                f"{defined.__module__}:{defined.__qualname__} defines {name!r}, which nothing calls; did you mean "
                f"{meant!r}? (else begin its name with an underscore)"
            )
    return found


def _methods(of: type) -> Iterator[tuple[str, type]]:
    """The public methods of a class, by name, and the class that defines each; what every object has left out."""
    for name in sorted(dir(of)):
        defined = next((each for each in of.__mro__ if name in vars(each)), object)
        if not name.startswith("_") and defined is not object and inspect.isroutine(inspect.getattr_static(of, name)):
            yield name, defined


def _alike(one: str, other: str) -> float:
    return SequenceMatcher(None, one.lower(), other.lower()).ratio()
