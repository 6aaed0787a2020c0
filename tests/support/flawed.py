"""A hierarchy of two nodes above a world, each operator of which can be given a flaw in one epoch."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

import numpy as np

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World

FLAW = "HIERAX_TEST_FLAW"
"""Environment variable: ``subject/operator/epoch``, where the result is another one."""

OPERATORS = {
    "low": ("observe", "select_policy", "policy", "predict"),
    "high": ("observe", "policy", "predict"),
    "world": ("predict",),
    "world->low": ("sense", "task", "context"),
    "low->high": ("sense", "task", "context"),
}
"""All that can be flawed."""

DEPLOYMENT = """\
hierarchy: flawed
world: world
epochs: 12
parameters: {gain: 0.5}
nodes:
  world: {class: "support.flawed:Source"}
  low: {class: "support.flawed:Level", parameters: {name: low, gain: "${gain}"}}
  high: {class: "support.flawed:Level", parameters: {name: high}}
edges:
  world -> low:
    sense: {function: "support.flawed:Sense", parameters: {name: "world->low"}}
    task: {function: "support.flawed:Task", parameters: {name: "world->low"}}
    context: {function: "support.flawed:Context", parameters: {name: "world->low"}}
  low -> high:
    sense: {function: "support.flawed:Sense", parameters: {name: "low->high"}}
    task: {function: "support.flawed:Task", parameters: {name: "low->high"}}
    context: {function: "support.flawed:Context", parameters: {name: "low->high"}}
"""


def is_flawed(subject: str, operator: str, tick: Tick) -> bool:
    """Whether this call gives another result."""
    return os.environ.get(FLAW) == f"{subject}/{operator}/{tick.epoch}"


class Level(Node):
    """Smooths what it observes, and expects what its context says.

    Args:
        name: of the node.
        gain: of what is new.
    """

    initial_policy = "still"

    def __init__(self, name: str, gain: float = 0.5) -> None:
        self._name = name
        self._gain = gain

    def initial_belief(self) -> Value:
        return {"level": 0.0, "trail": np.zeros(4), "taken": 0}

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        level = (1 - self._gain) * belief["level"] + self._gain * observations[0]["level"]
        if is_flawed(self._name, "observe", tick):
            level += 1.0
        return {**belief, "level": level}

    def select_policy(self, tasks: Elements, tick: Tick = NO_TICK) -> str:
        moves = bool(tasks) and tasks[0]["move"]
        if is_flawed(self._name, "select_policy", tick):
            moves = not moves
        return "move" if moves else "still"

    def policies(self) -> Mapping[str, Callable[..., Elements]]:
        return {"still": self._still, "move": self._move}

    def _still(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        return ({"by": 7.0},) if is_flawed(self._name, "policy", tick) else ({"by": 0.0},)

    def _move(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        return ({"by": 7.0},) if is_flawed(self._name, "policy", tick) else ({"by": belief["level"]},)

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        trail = np.roll(belief["trail"], 1)
        trail[0] = belief["level"] + sum(element["level"] for element in context)
        if is_flawed(self._name, "predict", tick):
            trail[2] += 0.25
        return {**belief, "trail": trail}

    def take_over(self, belief: Value) -> Value:
        return {**belief, "taken": belief["taken"] + 1}

    def metrics(self, belief: Value) -> Mapping[str, float]:
        return {"level": belief["level"]}


class Source(World):
    """A level that wanders."""

    initial_policy = "default"

    def initial_belief(self) -> Value:
        return {"level": 1.0}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        step = float(tick.rng.normal()) + 0.1 * sum(element["level"] for element in context)
        return {"level": belief["level"] + step + is_flawed("world", "predict", tick)}


class Sense:
    """φ: the level.

    Args:
        name: of the edge.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        return ({"level": belief["level"] + is_flawed(self._name, "sense", tick)},)


class Task:
    """ψ: whether to move.

    Args:
        name: of the edge.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, actions: Elements, tick: Tick = NO_TICK) -> Elements:
        moves = tick.epoch % 3 == 0
        return ({"move": moves != is_flawed(self._name, "task", tick), "by": actions[0]["by"]},)


class Context:
    """ϱ: the level that was seen last.

    Args:
        name: of the edge.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        return ({"level": float(belief["trail"][0]) + is_flawed(self._name, "context", tick)},)
