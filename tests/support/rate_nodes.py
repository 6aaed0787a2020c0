"""A world at a rate, and nodes that take their time."""

from __future__ import annotations

import time

from hierax.runtime import Elements, Node, Tick, Value, World


class Ticks(World):
    """Counts epochs."""

    def initial_belief(self) -> Value:
        return 0

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + 1


class Counts(Node):
    """Counts what it has observed."""

    def initial_belief(self) -> Value:
        return 0

    def observe(self, observations: Elements, belief: Value) -> Value:
        return belief + 1


class Sometimes(Node):
    """The same, but takes a while in epochs that `every` divides."""

    def __init__(self, every: int = 50, took_ms: float = 30.0) -> None:
        self.every = every
        self.took_ms = took_ms

    def initial_belief(self) -> Value:
        return 0

    def observe(self, observations: Elements, belief: Value, tick: Tick) -> Value:
        if tick.epoch % self.every == 0:
            time.sleep(self.took_ms / 1000.0)
        return belief + 1


def seen(belief: Value) -> Elements:
    """What goes up."""
    return (belief,)
