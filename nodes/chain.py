"""A chain of three nodes that do next to nothing: what an epoch costs by itself."""

import numpy as np

from hierax.runtime import Elements, Node, Value, World
from hierax.schemas.limits import MAX_MESSAGE_BYTES


class Counter(World):
    """N₀: counts what its actions add up to."""

    def initial_belief(self) -> Value:
        """Nothing counted, nothing seen."""
        return {"count": 0, "seen": 0.0}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """Count, and keep what came down."""
        return {"count": belief["count"] + 1, "seen": context[0]["level"] if context else belief["seen"]}


class Relay(Node):
    """Keeps the level that it observes, or that its context gives."""

    def initial_belief(self) -> Value:
        """There is no level yet."""
        return {"level": 0.0}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """The level seen."""
        return {"level": observations[0]["level"]}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """The level expected, where something is; each page of a picture beside it is looked at."""
        if not context:
            return belief
        if "picture" in context[0]:
            context[0]["picture"][::4096].max()
        return {"level": context[0]["level"]}


def count(belief: Value) -> Elements:
    """φ of the counter: half of what it has counted."""
    return ({"level": 0.5 * belief["count"]},)


def level(belief: Value) -> Elements:
    """φ and ϱ of a relay: its level."""
    return ({"level": belief["level"]},)


class LevelWithPicture:
    """ϱ of a relay, with a picture of so many bytes beside the level; none of 0."""

    def __init__(self, size: int = 0) -> None:
        if type(size) is not int or not 0 <= size <= MAX_MESSAGE_BYTES:
            raise ValueError(f"size: expected a number of bytes from 0 to {MAX_MESSAGE_BYTES}, got {size!r}")
        self._picture = np.zeros(size, np.uint8)

    def __call__(self, belief: Value) -> Elements:
        """The level, and the picture as a view of the same bytes in every epoch."""
        if not self._picture.size:
            return level(belief)
        return ({"level": belief["level"], "picture": self._picture},)
