"""Messages between parts, evidence in them, and what is checked of both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.extended_floats import ExtendedFloats, Floats, shifted

Arrow = tuple[str, str]  # a child and its parent
Messages = Mapping[str, Mapping[str, Floats]]  # by child, then by parent
# By node, the number of the state that it is in without doubt, or likelihoods.
Evidence = Mapping[str, int | tuple[float, ...]]

NOTHING: Messages = {}


def packed(message: ExtendedFloats) -> Floats:
    """A message as an array: fractions, then exponents."""
    scaled = shifted(message, 0)
    return np.stack([scaled.fraction, scaled.exponent.astype(np.float64)])


def unpacked(message: Floats) -> ExtendedFloats:
    """What `packed` wrote."""
    return ExtendedFloats(message[0], message[1].astype(np.int64))


def checked(message: Floats, size: int, parent: str) -> Floats:
    """A message about a parent with so many states. Raises ValueError: it has another shape."""
    if message.shape != (2, size):
        raise ValueError(f"a message about {parent}: expected shape (2, {size}), got {message.shape}")
    return message


def checked_evidence(seen: Any, size: int, name: str) -> int | tuple[float, ...]:
    """Evidence for a node with so many states. Raises ValueError: there is no state of that number, or the likelihoods
    are more or fewer."""
    if type(seen) is int:
        if not 0 <= seen < size:
            raise ValueError(f"evidence for {name}: expected a state from 0 to {size - 1}, got {seen}")
        return seen
    if len(seen) != size:
        raise ValueError(f"evidence for {name}: expected {size} likelihoods, got {len(seen)}")
    return tuple(seen)


def by_child(messages: Mapping[Arrow, Floats]) -> dict[str, dict[str, Floats]]:
    """Messages as they travel; `by_arrow` turns them back."""
    found: dict[str, dict[str, Floats]] = {}
    for (child, parent), message in messages.items():
        found.setdefault(child, {})[parent] = message
    return found


def by_arrow(messages: Messages) -> dict[Arrow, Floats]:
    """Messages that have come, by arrow."""
    return {(child, parent): message for child, given in messages.items() for parent, message in given.items()}
