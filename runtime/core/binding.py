"""Operators as the core calls them: one calling convention, results checked.

A user's operator may or may not take a ``tick``, and may be an ``async def``. Here
both are settled once, when a node is built, so that nothing has to look again."""

import inspect
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Any

import numpy as np

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import FAILURES, HierarchyError, OperatorError
from hierax.runtime.core.node import Allocate, Node, Tick, World
from hierax.schemas.errors import shown
from hierax.schemas.values import plain

Operator = Callable[..., Any]
Waiter = Callable[[Awaitable[Any]], Any]  # drives an awaitable to its result; the core itself has no event loop


@dataclass(frozen=True)
class OperatorSetting:
    """What a run gives to every operator."""

    seed: int = 0  # of all random numbers
    wait: Waiter | None = None  # drives operators that are ``async def``; None refuses them
    allocate: Allocate = np.empty  # gives the memory of `Tick.empty`


TAKES = {
    "initial_belief": (),
    "observe": ("observations", "belief"),
    "select_policy": ("tasks",),
    "predict": ("context", "actions", "belief"),
    "act": ("actions",),
    "policy": ("belief",),
    "sense": ("belief",),
    "task": ("actions",),
    "context": ("belief",),
}
"""What the caller passes to each operator and edge function, beside the tick."""


KEPT = frozenset({"initial_belief", "observe", "predict", "policy"})
"""Whose results are in a node's state: who goes on from a checkpoint, or a recording, has them as their bytes have."""


class Call:
    """One operator of one node or edge: call it with the epoch, its time and its arguments."""

    __slots__ = ("_above", "_below", "_function", "_is_kept", "_setting", "_wants_tick", "operator", "subject")

    def __init__(
        self,
        function: Operator,
        subject: str,
        operator: str,
        setting: OperatorSetting,
        *,
        below: tuple[str, ...],
        above: tuple[str, ...],
        takes: str = "",
    ) -> None:
        self.subject = subject
        self.operator = operator
        self._setting = setting
        self._below = below
        self._above = above
        self._is_kept = (takes or operator) in KEPT
        self._wants_tick = check_signature(function, operator, takes, subject)
        self._function = _synchronous(function, setting, f"{subject}: {operator}")

    def __call__(self, epoch: int, time_s: float, *arguments: Value) -> Any:
        """Call the operator. Raises `OperatorError` if it raised; the cause is chained."""
        try:
            if not self._wants_tick:
                given = self._function(*arguments)
            else:
                tick = self._tick(epoch, time_s)
                given = self._function(*arguments, tick=tick)
                tick.freeze()
            return plain(given) if self._is_kept else given
        except FAILURES as error:
            raise self._failed(epoch, error) from error

    def elements(self, epoch: int, time_s: float, argument: Value) -> Elements:
        """Call it for a set of elements, given as a tuple or list."""
        try:  # as `__call__` does, which would be one more call for every edge of every epoch
            if not self._wants_tick:
                result = self._function(argument)
            else:
                tick = self._tick(epoch, time_s)
                result = self._function(argument, tick=tick)
                tick.freeze()
        except FAILURES as error:
            raise self._failed(epoch, error) from error
        if self._is_kept:
            result = plain(result)
        if type(result) is tuple:
            return result
        if isinstance(result, (list, tuple)):
            return tuple(result)
        what = f"expected a tuple of elements, got {type(result).__name__}"
        raise OperatorError(self.subject, self.operator, epoch, what)

    def _tick(self, epoch: int, time_s: float) -> Tick:
        setting = self._setting
        where = (self.subject, self.operator, epoch, time_s, self._below, self._above)
        return Tick(setting.seed, *where, setting.allocate)

    def _failed(self, epoch: int, error: BaseException) -> OperatorError:
        what = _told(error)
        if isinstance(error, ValueError) and "read-only" in str(error):
            what += "; it writes into an array that is not its own: make a copy"
        return OperatorError(self.subject, self.operator, epoch, what)


CALLS = (Call.__call__.__code__, Call.elements.__code__)
"""The code in whose frames an operator is called; a frame's `self` is the call."""


def _told(error: BaseException) -> str:
    """An error's type, text and place, in one line whatever its text is."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}{text and f': {text}'}{_raised_at(error)}"


def _raised_at(error: BaseException) -> str:
    """The line that raised, for the user who wrote it."""
    last = error.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    if last is None or last.tb_frame.f_code.co_filename == __file__:  # it could not even be called
        return ""
    code = last.tb_frame.f_code
    return f" ({code.co_filename}:{last.tb_lineno}, in {code.co_name})"


class Policies(dict[str, Call]):
    """Π as calls, by name.

    Π may be infinite, one policy for each task: those that the node's mapping knows but
    does not list are bound when they are asked for, and not kept."""

    def __init__(self, policies: Mapping[str, Operator], bind: Callable[[Operator, str], Call]) -> None:
        super().__init__({name: bind(function, f"policy {name}") for name, function in policies.items()})
        self._policies = policies
        self._bind = bind

    lists = dict.__contains__
    """Whether a policy is listed."""

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in self._policies

    def __missing__(self, name: str) -> Call:
        return self._bind(self._policies[name], f"policy {name}")


class BoundNode:
    """A node with a name, its neighbours and the run's seed: all that its operators need.

    Raises `HierarchyError` if it is no node, an operator has a signature that cannot be called, what is no operator is
    an async function, a policy's name is no string, π⁰ is none of the policies, or λ(∅) ≠ π⁰."""

    __slots__ = (
        "_may_be_none",
        "above",
        "act",
        "below",
        "initial_belief",
        "name",
        "node",
        "observe",
        "policies",
        "predict",
        "select_policy",
    )

    def __init__(
        self, name: str, node: Node, below: tuple[str, ...], above: tuple[str, ...], setting: OperatorSetting
    ) -> None:
        if not isinstance(node, Node):
            raise HierarchyError(f"{name}: expected an object whose class derives from Node, got {node!r:.60}")
        self.name = name
        self.node = node
        self.below = below
        self.above = above
        self._may_be_none: bool | None = None
        _check_plain(name, node)

        def bound(function: Operator, operator: str, takes: str = "") -> Call:
            return Call(function, name, operator, setting, below=below, above=above, takes=takes)

        self.initial_belief = bound(node.initial_belief, "initial_belief")
        self.observe = bound(node.observe, "observe")
        self.select_policy = bound(node.select_policy, "select_policy")
        self.predict = bound(node.predict, "predict")
        self.act = bound(node.act, "act") if isinstance(node, World) and type(node).act is not World.act else None
        self.policies = Policies(_policies_of(name, node), partial(bound, takes="policy"))
        self._check_initial_policy()

    def choose(self, epoch: int, time_s: float, tasks: Elements) -> str:
        """λ, its result checked."""
        policy = self.select_policy(epoch, time_s, tasks)
        if type(policy) is str and self.policies.lists(policy):
            return policy
        if not isinstance(policy, str) or policy not in self.policies:
            known = ", ".join(sorted(self.policies))
            raise OperatorError(self.name, "select_policy", epoch, f"{policy!r:.60} is none of the policies {known}")
        return str.__str__(policy)  # the characters also of a str-Enum's member

    def accept_none(self, operator: Call, epoch: int) -> None:
        """An operator gave None for a belief, as without a `return`: raises `OperatorError`, if that may not be."""
        if self._may_be_none is None:
            self._may_be_none = self.initial_belief(0, 0.0) is None
        if not self._may_be_none:
            what = "gave None for the belief, and the initial belief is not None; does it lack a return?"
            raise OperatorError(self.name, operator.operator, epoch, what)

    def _check_initial_policy(self) -> None:
        nameless = [policy for policy in self.policies if not isinstance(policy, str)]
        if nameless:
            raise HierarchyError(f"{self.name}: a policy's name must be a string, not {nameless[0]!r:.60}")
        initial = self.node.initial_policy
        if initial not in self.policies:
            raise HierarchyError(
                f"{self.name}: the initial policy {initial!r} is none of its policies {sorted(self.policies)}"
            )
        chosen = self.select_policy(0, 0.0, ())
        if chosen != initial:
            raise HierarchyError(
                f"{self.name}: of no tasks, select_policy must give the initial policy {initial!r}, not {chosen!r}"
            )


def _check_plain(name: str, node: Node) -> None:
    """What is no operator is called where nothing can wait: raises `HierarchyError` if it is an async function."""
    for method in ("policies", "take_over", "metrics", "time_s", "finished"):
        if inspect.iscoroutinefunction(getattr(node, method, None)):
            raise HierarchyError(f"{name}: {method} is an async function; expected a plain one, as it is no operator")


def is_finished(name: str, world: World, belief: Value, epoch: int) -> bool:
    """Whether the world has nothing left to observe. Raises `OperatorError` if the world's `finished` raised."""
    try:
        return bool(world.finished(belief))
    except FAILURES as error:
        raise OperatorError(name, "finished", epoch, _told(error)) from error


def metrics_of(name: str, node: Node, belief: Value, epoch: int) -> dict[str, float]:
    """The figures that a node reports of its belief. Raises `OperatorError` if it gives none by name."""
    try:
        metrics = dict(node.metrics(belief).items())
    except FAILURES as error:
        raise OperatorError(name, "metrics", epoch, _told(error)) from error
    nameless = [metric for metric in metrics if not isinstance(metric, str)]
    if nameless:
        raise OperatorError(name, "metrics", epoch, f"expected figures by name, {nameless[0]!r:.60} is no string")
    return {metric: _figure(name, metric, value, epoch) for metric, value in metrics.items()}


def _figure(name: str, metric: str, value: Any, epoch: int) -> float:
    try:
        return float(value)
    except Exception as error:
        what = f"expected a number as {metric!r}, got {shown(value)}"
        raise OperatorError(name, "metrics", epoch, what) from error


def epoch_time_s(name: str, world: World, belief: Value, epoch: int) -> float:
    """The time of an epoch, by the world. Raises `OperatorError` if it raised, or gave no finite number."""
    try:
        time_s = float(world.time_s(belief, epoch))
    except FAILURES as error:
        raise OperatorError(name, "time_s", epoch, _told(error)) from error
    if not isfinite(time_s):
        raise OperatorError(name, "time_s", epoch, f"expected seconds, got {time_s}")
    return time_s


def _policies_of(name: str, node: Node) -> Mapping[str, Operator]:
    try:
        policies = node.policies()
    except FAILURES as error:
        raise HierarchyError(f"{name}: policies raised {_told(error)}") from error
    if not isinstance(policies, Mapping):
        raise HierarchyError(f"{name}: policies must give a mapping of names to functions, not {policies!r:.60}")
    return policies


def require_world(name: str, node: Node) -> World:
    """The node as N₀. Raises `HierarchyError` if its class does not derive from `World`."""
    if not isinstance(node, World):
        raise HierarchyError(f"{name}: the world's class must derive from World, {type(node).__name__} does not")
    return node


def require_no_world(name: str, node: Node) -> None:
    """A node above N₀, which nothing would ask for the time, nor to act: raises `HierarchyError` if it is a `World`."""
    if isinstance(node, World):
        what = f"only N₀ may derive from World, and {type(node).__name__} does; derive it from Node"
        raise HierarchyError(f"{name}: {what}")


def bind_edge(
    function: Operator | None, lower: str, upper: str, operator: str, setting: OperatorSetting
) -> Call | None:
    """An edge function as a call; none stands for the function that always gives the empty set."""
    if function is None:
        return None
    return Call(function, f"{lower}->{upper}", operator, setting, below=(lower,), above=(upper,))


def check_signature(function: Operator, operator: str, takes: str = "", subject: str = "") -> bool:
    """Whether a function wants the tick, too, called as one of `TAKES`. Raises `HierarchyError` if it is not fit."""
    arguments = TAKES[takes or operator]
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # some callables written in C tell nothing
        return False
    wants = "tick" in signature.parameters
    try:
        signature.bind(*arguments, **({"tick": None} if wants else {}))
    except TypeError as error:
        what = f"{operator} must take ({', '.join(arguments)}) and, if it likes, tick; it takes {signature}"
        raise HierarchyError(f"{subject}: {what}" if subject else what) from error
    misplaced = _misplaced(list(signature.parameters), arguments)
    if misplaced:
        what = f"{operator} is given ({', '.join(arguments)}) in this order; it takes {signature}"
        raise HierarchyError(f"{subject}: {what}" if subject else what)
    return wants


def _misplaced(names: Sequence[str], arguments: Sequence[str]) -> bool:
    """Whether a function calls one of its arguments as another one of them is called, which it would be given in its
    place; names of its own are its own affair."""
    given = dict(zip(names, arguments, strict=False))
    return any(name in arguments and name != argument for name, argument in given.items())


def _synchronous(function: Operator, setting: OperatorSetting, where: str) -> Operator:
    is_async = inspect.iscoroutinefunction(function) or inspect.iscoroutinefunction(
        getattr(function, "__call__", None)  # noqa: B004 - an edge function may be an object
    )
    if not is_async:
        return function
    wait = setting.wait
    if wait is None:
        raise HierarchyError(f"{where} is an async function, and nothing here can wait for it")
    return lambda *arguments, **options: wait(function(*arguments, **options))
