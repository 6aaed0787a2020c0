"""Operators and edge functions that change what they are given, in a run."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World
from hierax.runtime.core.difference import EVERY, is_due
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.hierarchy import Edge
from hierax.runtime.testing.runs import run_hierarchy


class Clock(World):
    """Counts."""

    def initial_belief(self) -> Value:
        return {"ticks": 0, "trail": {"steps": 0}}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return {**belief, "ticks": belief["ticks"] + 1}


class Meddler(Node):
    """Changes what it is given in one operator.

    Args:
        where: the operator that does so.
        after: how many epochs it behaves before.
    """

    def __init__(self, where: str, after: int = 0) -> None:
        self._where = where
        self._after = after

    def initial_belief(self) -> Value:
        return {"seen": 0, "past": {"sum": 0}, "grid": np.zeros((2, 3))}

    def observe(self, observations: Elements, belief: Value) -> Value:
        if self._meddles("observe", belief):
            belief["past"]["sum"] += 1
        if self._meddles("observations", belief):
            observations[0]["ticks"] = 9
        if self._meddles("array", belief):
            belief["grid"][1, 2] = 1.0
        return {**belief, "seen": belief["seen"] + 1}

    def policies(self) -> Any:
        return {"default": self._act}

    def _act(self, belief: Value) -> Elements:
        if self._meddles("policy", belief):
            belief["past"]["sum"] += 1
        return ({"push": 1},)

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        if self._meddles("predict", belief):
            belief["past"]["sum"] += 1
        if self._meddles("actions", belief):
            actions[0]["push"] = 2
        return {**belief, "grid": belief["grid"] + 1.0}

    def _meddles(self, where: str, belief: Value) -> bool:
        return self._where == where and belief["seen"] >= self._after


def seen(belief: Value) -> Elements:
    return (belief,)


def meddling(belief: Value) -> Elements:
    belief["trail"]["steps"] = 1
    return (belief,)


def run(meddler: Node, sense: Any = seen, epochs: int = 1) -> None:
    run_hierarchy({"world": Clock(), "low": meddler}, [Edge("world", "low", sense=sense)], epochs=epochs)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("observe", "low: observe in epoch 1: changed the belief that it was given (belief.past.sum: 0, then 1)"),
        ("observations", "low: observe in epoch 1: changed the observations that it was given (observations[0].ticks"),
        ("policy", "low: policy default in epoch 1: changed the belief that it was given (belief.past.sum: 0, then 1)"),
        ("predict", "low: predict in epoch 1: changed the belief that it was given (belief.past.sum: 0, then 1)"),
        ("actions", "low: predict in epoch 1: changed the actions that it was given (actions[0].push: 1, then 2)"),
    ],
)
def test_an_operator_that_changes_what_it_is_given_is_named(where: str, message: str) -> None:
    with pytest.raises(OperatorError, match=re.escape(message)):
        run(Meddler(where))


def test_so_is_an_edge_function() -> None:
    with pytest.raises(OperatorError, match=r"world->low: sense in epoch 1: changed the belief .*belief\.trail\.steps"):
        run(Meddler("nowhere"), meddling)


def test_so_is_a_world_that_changes_its_actions_as_it_acts() -> None:
    class Pusher(Clock):
        def policies(self) -> Any:
            return {"default": lambda belief: ({"push": 1},)}

        def act(self, actions: Elements, tick: Tick = NO_TICK) -> None:
            actions[0]["push"] = 2

    with pytest.raises(OperatorError, match=r"world: act in epoch 1: changed the actions .*\[0\]\.push: 1, then 2"):
        run_hierarchy({"world": Pusher()}, [])


def test_nobody_writes_into_an_array_of_a_belief_in_any_epoch() -> None:
    with pytest.raises(OperatorError, match=r"observe in epoch 4: ValueError: .*read-only.*; it writes into an array"):
        run(Meddler("array", after=3), epochs=5)


def test_what_begins_late_is_found_in_the_next_epoch_that_is_looked_at() -> None:
    with pytest.raises(OperatorError, match="low: observe in epoch 8: changed the belief"):
        run(Meddler("observe", after=4), epochs=9)


def test_who_behaves_is_left_alone() -> None:
    run(Meddler("nowhere"), epochs=EVERY + 1)


def test_which_epochs_are_looked_at() -> None:
    due = [epoch for epoch in range(1, 3 * EVERY + 1) if is_due(epoch)]
    assert due == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 768]
