"""Nodes and an edge function that scripts of tests give as themselves."""

from __future__ import annotations

from hierax.runtime import Elements, Node, Value


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
