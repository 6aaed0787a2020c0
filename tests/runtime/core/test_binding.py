"""Operators as the core calls them: signatures, ticks, waiting, errors."""

from __future__ import annotations

import asyncio
import enum
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World
from hierax.runtime.core.binding import BoundNode, Call, OperatorSetting, bind_edge, epoch_time_s, require_world
from hierax.runtime.core.errors import HierarchyError, OperatorError

SETTING = OperatorSetting(seed=7)


class Still(Node):
    """Does nothing."""

    def initial_belief(self) -> Value:
        return 0


def bound(node: Any, setting: OperatorSetting = SETTING) -> BoundNode:
    return BoundNode("arm", node, ("world",), ("spatial", "task"), setting)


def with_operator(name: str, function: Callable[..., Any]) -> Node:
    return type("Made", (Still,), {name: function})()


def test_the_defaults_keep_the_belief_and_do_nothing() -> None:
    node = bound(Still())
    assert node.initial_belief(0, 0.0) == 0
    assert node.observe(1, 0.0, ("seen",), "belief") == "belief"
    assert node.predict(1, 0.0, ("context",), ("act",), "belief") == "belief"
    assert node.choose(1, 0.0, ("task",)) == "default"
    assert node.policies["default"].elements(1, 0.0, "belief") == ()
    assert node.node.metrics("belief") == {}


def test_a_tick_is_given_where_asked_for() -> None:
    ticks: list[Tick] = []

    class Asks(Still):
        def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
            ticks.append(tick)
            return belief

        def policies(self) -> Mapping[str, Callable[..., Elements]]:
            return {"default": self.act}

        def act(self, belief: Value, *, tick: Tick) -> Elements:
            ticks.append(tick)
            return ()

    node = bound(Asks())
    node.observe(3, 0.15, (), 0)
    node.policies["default"](3, 0.15, 0)
    assert ticks == [
        Tick(7, "arm", "observe", 3, 0.15, ("world",), ("spatial", "task")),
        Tick(7, "arm", "policy default", 3, 0.15, ("world",), ("spatial", "task")),
    ]


def test_an_edge_function_gets_the_edges_tick() -> None:
    seen: list[Tick] = []

    def sense(belief: Value, scale: float, tick: Tick = NO_TICK) -> Elements:
        seen.append(tick)
        return (belief * scale,)

    call = bind_edge(functools.partial(sense, scale=2.0), "world", "arm", "sense", SETTING)
    assert call is not None
    assert call.elements(4, 0.2, 3.0) == (6.0,)
    assert seen == [Tick(7, "world->arm", "sense", 4, 0.2, ("world",), ("arm",))]
    assert bind_edge(None, "world", "arm", "sense", SETTING) is None


def test_an_edge_function_may_be_an_object() -> None:
    class Scaled:
        def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
            return (belief, tick.epoch)

    call = bind_edge(Scaled(), "world", "arm", "context", SETTING)
    assert call is not None
    assert call.elements(4, 0.2, 3.0) == (3.0, 4)


@pytest.mark.parametrize(
    ("operator", "function", "takes"),
    [
        ("initial_belief", lambda self, seed: 0, "()"),
        ("observe", lambda self, observations: 0, "(observations, belief)"),
        ("observe", lambda self, observations, belief, more: 0, "(observations, belief)"),
        ("observe", lambda self, belief, *, tick, more: 0, "(observations, belief)"),
        ("select_policy", lambda self: "default", "(tasks)"),
        ("predict", lambda self, context, belief: 0, "(context, actions, belief)"),
        ("predict", lambda self, context, tick, belief: 0, "(context, actions, belief)"),
    ],
)
def test_a_signature_that_cannot_be_called_is_refused(operator: str, function: Any, takes: str) -> None:
    with pytest.raises(HierarchyError) as raised:
        bound(with_operator(operator, function))
    assert str(raised.value).startswith(f"arm: {operator} must take {takes} and, if it likes, tick; it takes (")


@pytest.mark.parametrize(
    ("operator", "function"),
    [
        ("observe", lambda self, belief, observations: observations),
        ("observe", lambda self, belief, seen: seen),
        ("predict", lambda self, belief, context, actions, tick: belief),
    ],
)
def test_arguments_in_another_order_are_refused(operator: str, function: Any) -> None:
    with pytest.raises(HierarchyError, match=rf"^arm: {operator} is given \(.*belief\) in this order; it takes \("):
        bound(with_operator(operator, function))


def test_arguments_may_have_other_names() -> None:
    assert bound(with_operator("observe", lambda self, seen, state: state)).observe(1, 0.0, (), 3) == 3


def test_what_an_operator_raises_is_told_in_one_line() -> None:
    def broken(self: Node, observations: Elements, belief: Value) -> Value:
        raise RuntimeError("the sensor\n  is broken")

    told = r"^arm: observe in epoch 1: RuntimeError: the sensor is broken \(.*, in broken\)$"
    with pytest.raises(OperatorError, match=told):
        bound(with_operator("observe", broken)).observe(1, 0.0, (), 3)


def test_a_policys_and_an_edge_functions_signature_is_checked() -> None:
    with pytest.raises(HierarchyError, match=r"arm: policy default must take \(belief\)"):
        bound(with_operator("policies", lambda self: {"default": lambda: ()}))
    with pytest.raises(HierarchyError, match=r"world->arm: task must take \(actions\)"):
        bind_edge(lambda: (), "world", "arm", "task", SETTING)


@pytest.mark.parametrize(
    ("node", "reason"),
    [
        (Still, "arm: expected an object whose class derives from Node, got <class"),
        (None, "arm: expected an object whose class derives from Node, got None"),
        (
            with_operator("policies", lambda self: {"follow": lambda belief: ()}),
            r"arm: the initial policy 'default' is none of its policies \['follow'\]",
        ),
        (
            with_operator("policies", lambda self: {"default": lambda belief: (), 3: lambda belief: ()}),
            "arm: a policy's name must be a string, not 3",
        ),
        (
            with_operator("select_policy", lambda self, tasks: "follow"),
            "arm: of no tasks, select_policy must give the initial policy 'default', not 'follow'",
        ),
    ],
)
def test_a_node_that_is_none_is_refused(node: Any, reason: str) -> None:
    with pytest.raises(HierarchyError, match=reason):
        bound(node)


def test_the_policy_chosen_must_be_one() -> None:
    choices: dict[Elements, Any] = {(): "default", (1,): "fly", (2,): None, (3,): ["default"]}
    node = bound(with_operator("select_policy", lambda self, tasks: choices[tasks]))
    for tasks in [(1,), (2,), (3,)]:
        with pytest.raises(OperatorError, match=r"arm: select_policy in epoch 6: .* is none of the policies default"):
            node.choose(6, 0.0, tasks)


def test_the_policys_name_is_a_plain_string() -> None:
    class Policies(str, enum.Enum):
        DEFAULT = "default"

    for name in (Policies.DEFAULT, np.str_("default")):
        node = bound(with_operator("select_policy", lambda self, tasks, name=name: name))
        chosen = node.choose(1, 0.0, (1,))
        assert chosen == "default"
        assert type(chosen) is str


def test_what_an_operator_raises_is_named_and_chained() -> None:
    def fail(self: Node, observations: Elements, belief: Value) -> Value:
        raise KeyError("pose")

    node = bound(with_operator("observe", fail))
    with pytest.raises(
        OperatorError, match=r"^arm: observe in epoch 9: KeyError: 'pose' \(\S+\.py:\d+, in fail\)$"
    ) as raised:
        node.observe(9, 0.0, (), 0)
    error = raised.value
    assert (error.subject, error.operator, error.epoch) == ("arm", "observe", 9)
    assert isinstance(error.__cause__, KeyError)


def test_a_failing_initial_policy_is_an_operators_error_before_the_first_epoch() -> None:
    def fail(self: Node, tasks: Elements) -> str:
        return tasks[0]

    with pytest.raises(OperatorError, match=r"^arm: select_policy in epoch 0: IndexError"):
        bound(with_operator("select_policy", fail))


@pytest.mark.parametrize("result", [None, "text", {"a": 1}, np.zeros(2), 3.0, (x for x in "ab")])
def test_elements_must_be_a_tuple_or_list(result: Any) -> None:
    call = Call(lambda belief: result, "a->b", "sense", SETTING, below=(), above=())
    with pytest.raises(OperatorError, match="a->b: sense in epoch 2: expected a tuple of elements, got"):
        call.elements(2, 0.0, None)


def test_a_list_of_elements_becomes_a_tuple() -> None:
    call = Call(lambda belief: [1, [2]], "a->b", "sense", SETTING, below=(), above=())
    assert call.elements(1, 0.0, None) == (1, [2])


class Asks(Still):
    """Waits for the outside."""

    async def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        await asyncio.sleep(0)
        return (*observations, tick.epoch)

    def policies(self) -> Mapping[str, Callable[..., Any]]:
        return {"default": functools.partial(self.act, "gain")}

    async def act(self, gain: str, belief: Value) -> Elements:
        return (gain,)


class AsyncEdge:
    async def __call__(self, belief: Value) -> Elements:
        return (belief,)


def test_an_async_operator_is_waited_for() -> None:
    setting = OperatorSetting(wait=asyncio.run)
    node = bound(Asks(), setting)
    assert node.observe(4, 0.0, ("seen",), 0) == ("seen", 4)
    assert node.policies["default"].elements(4, 0.0, 0) == ("gain",)
    call = bind_edge(AsyncEdge(), "world", "arm", "sense", setting)
    assert call is not None
    assert call.elements(1, 0.0, 5) == (5,)


def test_an_async_operator_is_refused_where_nothing_waits() -> None:
    with pytest.raises(HierarchyError, match=r"^arm: observe is an async function, and nothing here can wait for it$"):
        bound(Asks())
    with pytest.raises(HierarchyError, match=r"^world->arm: sense is an async function"):
        bind_edge(AsyncEdge(), "world", "arm", "sense", SETTING)


@pytest.mark.parametrize("method", ["policies", "take_over", "metrics", "time_s", "finished"])
def test_what_is_no_operator_may_not_be_async(method: str) -> None:
    async def given(*_: Any) -> Any:
        return None

    with pytest.raises(HierarchyError, match=rf"^arm: {method} is an async function; expected a plain one"):
        bound(type("Waits", (Clock,), {method: given})(None), OperatorSetting(wait=asyncio.run))


class Clock(World):
    def __init__(self, time: Any) -> None:
        self.time = time

    def initial_belief(self) -> Value:
        return None

    def time_s(self, belief: Value, epoch: int) -> float:
        return self.time(belief, epoch)


def test_the_worlds_time_is_a_finite_float() -> None:
    assert type(epoch_time_s("world", Clock(lambda belief, epoch: np.float32(epoch)), None, 3)) is float
    assert epoch_time_s("world", Clock(lambda belief, epoch: 2 * epoch), None, 3) == 6.0
    for time in (lambda b, e: float("nan"), lambda b, e: None, lambda b, e: 1 / 0):
        with pytest.raises(OperatorError, match=r"^world: time_s in epoch 3: "):
            epoch_time_s("world", Clock(time), None, 3)


def test_by_default_an_epoch_takes_a_second_and_the_world_never_ends() -> None:
    class Plain(World):
        def initial_belief(self) -> Value:
            return None

    assert [Plain().time_s(None, epoch) for epoch in (1, 2)] == [0.0, 1.0]
    assert not Plain().finished(None)


def test_the_world_must_be_a_world() -> None:
    with pytest.raises(HierarchyError, match=r"^sea: the world's class must derive from World, Still does not$"):
        require_world("sea", Still())
