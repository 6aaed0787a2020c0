"""Who is blamed for what cannot travel, and for None."""

from __future__ import annotations

import re
from typing import Any

import pytest

from hierax.runtime import Elements, Node, Value, World
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.testing.runs import run_hierarchy


class Clock(World):
    """Counts."""

    def initial_belief(self) -> Value:
        return 0

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + 1


class Giver(Node):
    """Gives something else at one place.

    Args:
        where: the operator.
        what: it gives.
        initial: its initial belief.
    """

    def __init__(self, where: str, what: Value, initial: Value = 0) -> None:
        self._where = where
        self._what = what
        self._initial = initial

    def initial_belief(self) -> Value:
        return self._initial

    def observe(self, observations: Elements, belief: Value) -> Value:
        return {"seen": self._what} if self._where == "observe" else self._given("bare observe", belief)

    def policies(self) -> Any:
        return {"default": lambda belief: (self._given("policy", 1),)}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return self._given("predict", belief)

    def _given(self, where: str, otherwise: Value) -> Value:
        return self._what if self._where == where else otherwise


def seen(belief: Value) -> Elements:
    return (belief,)


def run(node: Node, **functions: Any) -> None:
    edges = [Edge("world", "low", **{"sense": seen, **functions})]
    run_hierarchy({"world": Clock(), "low": node}, edges, epochs=3)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("observe", "low: observe in epoch 1: its belief: value.seen: a set cannot be sent"),
        ("policy", "low: policy default in epoch 1: its actions: value[0]: a set cannot be sent"),
        ("predict", "low: predict in epoch 1: its belief: value: a set cannot be sent"),
    ],
)
def test_the_operator_that_made_it(where: str, message: str) -> None:
    with pytest.raises(OperatorError, match=re.escape(message)):
        run(Giver(where, {1, 2}))


@pytest.mark.parametrize("kind", ["sense", "task", "context"])
def test_the_edge_function_that_made_it(kind: str) -> None:
    receiver = "low" if kind == "sense" else "world"
    with pytest.raises(OperatorError, match=rf"world->low: {kind} in epoch 1: its elements for {receiver}: .*a set"):
        run(Giver("", 0), **{kind: lambda _: ({1},)})


@pytest.mark.parametrize(("where", "operator"), [("bare observe", "observe"), ("predict", "predict")])
def test_none_where_the_initial_belief_is_something(where: str, operator: str) -> None:
    message = f"low: {operator} in epoch 1: gave None for the belief, and the initial belief is not None"
    with pytest.raises(OperatorError, match=message):
        run(Giver(where, None))
    hierarchy = Hierarchy(
        {"world": Clock(), "low": Giver(where, None)}, "world", [Edge("world", "low", sense=seen)], OperatorSetting()
    )
    with pytest.raises(OperatorError, match=message):
        update(ActiveHierarchy.initial(hierarchy))


def test_none_where_the_initial_belief_is_none_too() -> None:
    run(Giver("bare observe", None, initial=None))
    run(Giver("predict", None, initial=None))
