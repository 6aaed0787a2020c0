"""The node that a user writes: at most five operators on values (definition 1)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

Value = Any
"""A value as `hierax.schemas.values` describes it; never mutated."""

Elements = tuple[Value, ...]
"""A set of the theory (observations, actions, task parameters, context), in a fixed order."""

Policy = Callable[..., Elements]


def do_nothing(belief: Value) -> Elements:
    """The policy that takes no action."""
    return ()


class Node(ABC):
    """A node of a cognitive hierarchy: a language, policies and update operators.

    All operators are plain functions of values: they keep nothing in the object that
    changes what they return, and never mutate what they are given. A simulator or a
    device is a cache of the belief. An operator that needs the epoch, the time, the
    neighbours' names or random numbers takes a further parameter ``tick: Tick = NO_TICK``.
    An operator may be an ``async def`` where it waits for the outside.

    Attributes:
        initial_policy: name of π⁰, which `select_policy` must return for no tasks.
    """

    initial_policy: ClassVar[str] = "default"

    @abstractmethod
    def initial_belief(self) -> Value:
        """s⁰: the belief before the first epoch. Called once, when the node is built."""

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ: the belief after the epoch's observations. Called once an epoch, before `predict`.

        Args:
            observations: of all edges from below, by the lower node's name, then as the
                edge gave them; doubles are kept. Empty where nothing was observed.
            belief: s, as the last epoch's prediction left it.

        Returns:
            The new belief. By default, the old one.
        """
        return belief

    def select_policy(self, tasks: Elements) -> str:
        """λ: the policy for the task parameters from above; not called at a root.

        Returns:
            A name in `policies`; of no tasks, `initial_policy`.
        """
        return self.initial_policy

    def policies(self) -> Mapping[str, Policy]:
        """Π: by name, the functions from the belief (before `predict`) to actions."""
        return {self.initial_policy: do_nothing}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: the belief predicted for the next epoch. Called once an epoch, after `observe`.

        Args:
            context: of all edges from above, by the upper node's name, then as the edge
                gave it; doubles are kept. Empty at a root.
            actions: what the policy chose, in order.
            belief: s, as `observe` left it.

        Returns:
            The new belief. By default, the old one.
        """
        return belief

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """Figures about the belief, by name, for the report of a run. None by default."""
        return {}


class World(Node):
    """N₀, the external world: its `predict` makes the actuators move and time pass."""

    def time_s(self, belief: Value, epoch: int) -> float:
        """The time of an epoch that begins in `belief`, in seconds. By default the epoch's number less one."""
        return float(epoch - 1)

    def finished(self, belief: Value) -> bool:
        """Whether there is nothing left to observe; asked before each epoch. By default never."""
        return False
