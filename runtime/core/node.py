"""The node that a user writes: at most five operators on values (definition 1); and what they may know besides."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.random import Generator, Philox  # by name: `np.random` would be imported in the first epoch that draws
from numpy.typing import DTypeLike, NDArray

from hierax.runtime.core.elements import Elements, Value
from hierax.schemas.values import plain

if TYPE_CHECKING:
    from hierax.runtime.core.probe import Step
    from hierax.runtime.core.showing import Things

Policy = Callable[..., Elements]
Allocate = Callable[..., NDArray[Any]]


@dataclass(frozen=True)
class Tick:
    """Given to an operator or edge function that has a parameter named ``tick``.

    Attributes:
        seed: the run's seed.
        subject: the node, or the edge as ``lower->upper``.
        operator: which operator or edge function is called.
        epoch: counts from 1; 0 outside of a run.
        time_s: the epoch's time in seconds, as the world set it.
        below, above: names of the neighbours of the node (of an edge function: of the edge's lower and upper node).
        allocate: where the memory of `empty` comes from, as `numpy.empty`.
    """

    seed: int = 0
    subject: str = ""
    operator: str = ""
    epoch: int = 0
    time_s: float = 0.0
    below: tuple[str, ...] = ()
    above: tuple[str, ...] = ()
    allocate: Allocate = field(default=np.empty, repr=False, compare=False)

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = float) -> NDArray[Any]:
        """An array to be filled and returned, all of it, as `numpy.empty`: where it can, the runtime gives memory that
        receivers on this machine read in place, so that it is not copied. Nobody can write into it any more once the
        operator has returned.

        Args:
            shape, dtype: as of `numpy.empty`.
        """
        array = self.allocate(shape, dtype)
        self._given.append(array)
        return array

    def freeze(self) -> None:
        """The operator has returned: what it was given is written to no more."""
        for array in self.__dict__.get("_given", ()):
            array.flags.writeable = False
            if isinstance(array.base, np.ndarray):
                array.base.flags.writeable = False

    @cached_property
    def _given(self) -> list[NDArray[Any]]:
        return []

    @cached_property
    def rng(self) -> Generator:
        """Random numbers of this call: the same ones when the epoch is done again."""
        key = f"{self.seed}/{self.subject}/{self.operator}/{self.epoch}"
        entropy = hashlib.blake2b(key.encode(), digest_size=16).digest()
        return Generator(Philox(int.from_bytes(entropy, "little")))


NO_TICK = Tick()
"""The default of a ``tick`` parameter, for calls outside of a run."""


def structural_difference(expected: Value, given: Value, where: str = "belief") -> str:
    """The first place where two values are built differently; empty where they are not.

    What is expected to be None in a map is not known yet, and may be given as anything."""
    if isinstance(expected, np.ndarray) and isinstance(given, np.ndarray):
        if (expected.dtype, expected.ndim) != (given.dtype, given.ndim):
            wanted, got = f"{expected.dtype}, {expected.ndim}-d", f"{given.dtype}, {given.ndim}-d"
            return f"{where}: expected an array of {wanted}, got one of {got}"
        return ""
    kinds = [list if isinstance(value, (list, tuple)) else type(value) for value in (expected, given)]
    if kinds[0] is not kinds[1]:
        return f"{where}: expected {type(expected).__name__}, got {type(given).__name__}"
    if isinstance(expected, dict):
        if expected.keys() != given.keys():
            return f"{where}: expected the keys {sorted(expected)}, got {sorted(given)}"
        known = [key for key in expected if expected[key] is not None]
        parts = (structural_difference(expected[key], given[key], f"{where}.{key}") for key in known)
        return next(filter(None, parts), "")
    return ""


def do_nothing(belief: Value) -> Elements:
    """The policy that takes no action."""
    return ()


def class_name(node: object) -> str:
    """A node's class as deployment files name it, ``package.module:Class``."""
    return f"{type(node).__module__}:{type(node).__qualname__}"


class Node(ABC):
    """A node of a cognitive hierarchy: a language, policies and update operators.

    All operators are plain functions of values: they keep nothing in the object that changes what they return, and
    never mutate what they are given. A simulator or a device is a cache of the belief. An operator that needs the
    epoch, the time, the neighbours' names or random numbers takes a further parameter ``tick: Tick = NO_TICK``. An
    operator may be an ``async def`` where it waits for the outside.

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

    def take_over(self, belief: Value) -> Value:
        """The belief to go on with where this node replaces another one in a running hierarchy.

        Args:
            belief: the other node's.

        Returns:
            By default the same, if it is built like this node's initial belief: the same types, keys of maps and dtypes
            of arrays. Lengths may differ, and what is None in a map of the initial belief may be anything.

        Raises:
            ValueError: it cannot be taken over; says why.
        """
        difference = structural_difference(plain(self.initial_belief()), belief)
        if difference:
            raise ValueError(difference)
        return belief

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """Figures about the belief, by name, for the report of a run. None by default."""
        return {}

    def show(self, step: "Step", before: Value) -> "Things":
        """What a viewer is to show of an epoch; never called while nobody looks, nor in the node's process.

        `hierax inspect` prints its texts and figures.

        Args:
            step: what the node did in it.
            before: the belief that the epoch began in; None where the viewer does not know it.

        Returns:
            Things of `hierax.runtime.core.showing` by path; the first part of a path names the
            view. By default the figures of `metrics`, as curves in a view of the node's own.
        """
        return {f"metrics/{name}": value for name, value in self.metrics(step.belief).items()}


class World(Node):
    """N₀, the external world: its `predict` makes the actuators move and time pass.

    Attributes:
        works_ahead: whether `predict`, and the edge functions φ of what it gives, may be called as soon as the epoch's
            actions are known, while the other nodes are still at work on the epoch. For a simulation, or what is read
            from files: not for what senses when it is called, as that would then be older than its epoch. Where the
            world gets context, it was in vain, and both are called again.
    """

    works_ahead: ClassVar[bool] = False

    def time_s(self, belief: Value, epoch: int) -> float:
        """The time of an epoch that begins in `belief`, in seconds. By default the epoch's number less one."""
        return float(epoch - 1)

    def act(self, actions: Elements, tick: Tick = NO_TICK) -> None:
        """Move real actuators; called once an epoch, when its actions stand, before it is committed.

        Not for a world whose act is a function of its belief: that is done by `predict`. Where a process dies in the
        middle of an act, ``on_uncertain_act`` in the deployment file says whether it is repeated; ``tick.epoch`` is the
        key by which a device can tell a repeated act."""
        return

    def finished(self, belief: Value) -> bool:
        """Whether there is nothing left to observe; asked before each epoch. By default never."""
        return False
