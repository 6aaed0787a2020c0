"""`check_node` lets right nodes through, and says what is wrong with others."""

from __future__ import annotations

import itertools
import random
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from support.hierarchies import MixingNode, MixingWorld

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World
from hierax.runtime.core.difference import difference
from hierax.runtime.testing.node import check_node, make_inputs

READINGS: list[Elements] = [(1.0,), (2.0, 3.0), ()]


class Right(Node):
    """Sums readings, and adds noise."""

    def initial_belief(self) -> Value:
        return {"x": np.zeros(3), "n": 0}

    def observe(self, observations: Elements, belief: Value) -> Value:
        return {"x": belief["x"] + sum(observations), "n": belief["n"] + len(observations)}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        return {**belief, "x": belief["x"] + tick.rng.normal(size=3)}


def test_a_right_node_gives_its_steps() -> None:
    steps = check_node(Right, observations=READINGS)
    assert [step.epoch for step in steps] == [1, 2, 3]
    assert [step.belief["n"] for step in steps] == [1, 3, 3]
    again = check_node(Right(), observations=READINGS)
    assert all((one.belief["x"] == other.belief["x"]).all() for one, other in zip(steps, again, strict=True))
    other = check_node(Right, observations=READINGS, seed=1)
    assert (other[0].belief["x"] != steps[0].belief["x"]).all()


@pytest.mark.parametrize("node", [MixingNode("mid", 3), lambda: MixingNode("mid", 3), MixingWorld("world", 2)])
def test_nodes_with_policies_and_worlds(node: Any) -> None:
    check_node(node, observations=[(1,)], tasks=[(1,), (2, 3), ()], context=[((1, 2),)], name="mid")


def test_async_operators_are_waited_for() -> None:
    class Waiting(Right):
        async def observe(self, observations: Elements, belief: Value) -> Value:  # type: ignore[override]
            return super().observe(observations, belief)

    assert check_node(Waiting, observations=READINGS)[-1].belief["n"] == 3


class ChangesBelief(Right):
    def observe(self, observations: Elements, belief: Value) -> Value:
        belief["n"] += 1
        return belief


class WritesArray(Right):
    def observe(self, observations: Elements, belief: Value) -> Value:
        belief["x"] += 1
        return belief


class OwnDice(Right):
    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:  # type: ignore[override]
        return {**belief, "n": random.random()}


class Counts(Right):
    def __init__(self) -> None:
        self.epochs = 0

    def observe(self, observations: Elements, belief: Value) -> Value:
        self.epochs += 1
        return {**belief, "n": self.epochs}


class Remembers(Right):
    """The same twice in a row, but not later."""

    def __init__(self) -> None:
        self.seen: set[float] = set()

    def observe(self, observations: Elements, belief: Value) -> Value:
        self.seen |= set(observations)
        return {**belief, "n": len(self.seen)}


class Buffers(Right):
    def __init__(self) -> None:
        self.buffer = np.zeros(3)

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:  # type: ignore[override]
        self.buffer[:] = belief["x"]
        return {**belief, "x": self.buffer}


class CannotTravel(Right):
    def observe(self, observations: Elements, belief: Value) -> Value:
        return {**belief, "seen": {1, 2}}


class Grows(Right):
    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:  # type: ignore[override]
        return {**belief, "more": 1}


class NoTuple(Right):
    def policies(self) -> Mapping[str, Any]:
        return {"default": lambda belief: 3}


class HiddenPolicy(Right):
    """A policy that is never chosen here, and wrong."""

    def policies(self) -> Mapping[str, Any]:
        return {"default": lambda belief: (), "rash": lambda belief: (object(),)}


class NoPolicy(Right):
    def select_policy(self, tasks: Elements) -> str:
        return "fast" if tasks else "default"


class NoFigures(Right):
    def metrics(self, belief: Value) -> Mapping[str, Any]:
        return {"error": "much"}


class Numbered(Right):
    numbers = itertools.count()

    def __init__(self) -> None:
        self.number = next(self.numbers)

    def observe(self, observations: Elements, belief: Value) -> Value:
        return {**belief, "n": self.number}


class Timeless(World):
    def initial_belief(self) -> Value:
        return 0

    def time_s(self, belief: Value, epoch: int) -> float:
        return float("nan")


class Raises(Right):
    def observe(self, observations: Elements, belief: Value) -> Value:
        raise RuntimeError("no camera")


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        (
            ChangesBelief,
            "observe in epoch 1 changed what it was given; make a copy, or a new value (argument 2.n: 0",
        ),
        (WritesArray, "; it writes into an array that is not its own: make a copy"),
        (OwnDice, "predict in epoch 1 gave two results for the same arguments; random numbers come from tick.rng"),
        (Counts, "observe in epoch 1 gave two results for the same arguments"),
        (Remembers, "observe in epoch 1 gave another result when it was called again later"),
        (Buffers, "what predict returned in epoch 2 was changed later; return a new value every time (x[0] "),
        (CannotTravel, "observe in epoch 1: its result value.seen: a set cannot be sent"),
        (Grows, "take_over of its own belief after epoch 1: it refuses: ValueError: belief: expected the keys"),
        (NoTuple, "policy default in epoch 1: expected a tuple of elements, got int"),
        (HiddenPolicy, "policy rash in epoch 1: its result value[0]: a object cannot be sent"),
        (NoPolicy, "select_policy in epoch 1: 'fast' is none of the policies default"),
        (NoFigures, "metrics in epoch 0: expected a number as "),
        (Numbered, "another object of its class gave another sensed in epoch 1 (n: "),
        (Timeless, "time_s in epoch 1: expected seconds, got nan"),
        (Raises, "observe in epoch 1: RuntimeError: no camera"),
    ],
)
def test_what_is_wrong_is_named(wrong: type[Node], what: str) -> None:
    with pytest.raises(AssertionError) as caught:
        check_node(wrong, observations=READINGS, tasks=[("hurry",)])
    assert what in str(caught.value)
    assert str(caught.value).startswith("node: ")


def test_a_hint_is_given_once() -> None:
    with pytest.raises(AssertionError) as caught:
        check_node(WritesArray, observations=READINGS)
    assert str(caught.value).count("make a copy") == 1


@pytest.mark.parametrize(
    ("observations", "what"),
    [
        ([1.0], "observations[0]: expected a tuple of elements, got 1.0"),
        ([(1.0,), {"x": 1.0}], "observations[1]: expected a tuple of elements, got a dict"),
        (["ab"], "observations[0]: expected a tuple of elements, got 'ab'"),
        (3, "observations: expected a list with a tuple for each epoch, got 3"),
        ({"x": (1.0,)}, "observations: expected a list with a tuple for each epoch, got a dict"),
    ],
)
def test_inputs_that_are_no_elements_are_named(observations: Any, what: str) -> None:
    with pytest.raises(AssertionError) as caught:
        check_node(Right, observations=observations)
    assert str(caught.value) == what


def test_no_node_at_all() -> None:
    with pytest.raises(AssertionError, match="expected a Node, or what makes one"):
        check_node(lambda: 3)  # type: ignore[arg-type, return-value]


def test_inputs_that_are_shorter_begin_again() -> None:
    inputs = make_inputs([(1,), (2,)], [], [("c",)] * 3)
    assert [(each.observations, each.tasks, each.context) for each in inputs] == [
        ((1,), (), ("c",)),
        ((2,), (), ("c",)),
        ((1,), (), ("c",)),
    ]
    assert len(make_inputs([], [], [])) == 3
    assert len(make_inputs([(1,)], [], [], epochs=7)) == 7


@pytest.mark.parametrize(
    ("one", "other", "where"),
    [
        ({"a": (1, 2)}, {"a": (1, 2)}, ""),
        ({"a": (1, 2)}, {"a": (1, 3)}, "a[1]: 2, then 3"),
        ({"a": 1}, {"b": 1}, "a: 1, then '(absent)'"),
        ((1,), (1, 2), "[1]: '(absent)', then 2"),
        ({"x": np.zeros((2, 2))}, {"x": np.array([[0.0, 0.0], [0.0, 5.0]])}, "x[1][1]: 0.0, then 5.0"),
        (np.zeros(2), np.zeros(2, np.float32), "(array): 'float64 2', then 'float32 2'"),
        (np.array([np.nan]), np.array([np.nan]), ""),
        (0.0, -0.0, "value: 0.0, then -0.0"),
    ],
)
def test_the_first_difference(one: Value, other: Value, where: str) -> None:
    assert difference(one, other) == where
