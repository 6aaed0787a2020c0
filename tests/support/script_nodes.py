"""Nodes and an edge function that scripts of tests give as themselves."""

from __future__ import annotations

import numpy as np

from hierax.runtime import Elements, Node, Value, World


def seen(belief: Value) -> Elements:
    """What the toys send up."""
    return (belief,)


class Failing(Node):
    """Raises in its third epoch."""

    def initial_belief(self) -> Value:
        return 0

    def observe(self, observations: Elements, belief: Value) -> Value:
        if belief == 2:
            raise ArithmeticError("out of luck")
        return belief + 1


class Interrupted(Failing):
    """Somebody presses Ctrl-C while it observes."""

    def observe(self, observations: Elements, belief: Value) -> Value:
        raise KeyboardInterrupt


class Meaning(Node):
    """Keeps numpy's own numbers and a list in its belief, which decide on dtypes and types in the next epoch."""

    def initial_belief(self) -> Value:
        return {"gain": np.float64(0.5), "image": np.zeros(3, np.float32), "seen": []}

    def observe(self, observations: Elements, belief: Value) -> Value:
        pixels = np.full(3, observations[0], np.float32)
        return {
            "gain": np.mean([0.5, 0.25]),
            "image": belief["gain"] * pixels,
            "seen": [*belief["seen"][-2:], type(belief["seen"]).__name__],
        }


class Refusing(Node):
    """Cannot begin: its constructor, its initial belief or taking over raises, by `what`."""

    def __init__(self, what: str = "made") -> None:
        self._what = what
        self._raise("made")

    def initial_belief(self) -> Value:
        self._raise("begun")
        return 0

    def take_over(self, belief: Value) -> Value:
        self._raise("taken over")
        return belief

    def _raise(self, what: str) -> None:
        if what == self._what:
            raise ValueError(f"cannot be {what}")


class Idle(World):
    """Is alone, and counts."""

    def initial_belief(self) -> Value:
        return 0

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + 1
