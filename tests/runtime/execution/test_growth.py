"""What a node costs does not grow with how many there are: counted in lines of Python, whatever else is running."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from random import Random
from types import FrameType
from typing import Any

import pytest

from hierax.nodes.chain import Counter, Relay, count, level
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.execution.single import SingleRun
from hierax.runtime.loading.allowance import ANYTHING
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.scripting.hierarchy import Hierarchy
from hierax.runtime.transport.port import NEW, DrawnSet, MemoryNetwork
from hierax.schemas.messages import OBSERVATIONS, Header, Message

FEW, MANY = 20, 160
EPOCHS = 4
SHAPES: dict[str, Callable[[int], int]] = {
    "chain": lambda index: index - 1,
    "star": lambda index: 0,
    "tree": lambda index: (index - 1) // 3,
    "a node over many": lambda index: 0 if index < 4 else 1 + index % 3,
}
"""The node below each."""


def nothing(actions: Elements) -> Elements:
    """ψ that asks for nothing."""
    return ()


def described(shape: str, size: int, every: int = 1, delay: int = 0, tasks: bool = False, **fields: Any) -> Hierarchy:
    made = Hierarchy("grown", **fields).add("n0", Counter)
    others: dict[str, Any] = {"every": every} if every > 1 else {}
    ends: dict[str, Any] = {"delay": delay} if delay else {}
    ends |= {"task": nothing} if tasks else {}
    for index in range(1, size):
        made.add(f"n{index}", Relay, **others)
    for index in range(1, size):
        lower = SHAPES[shape](index)
        made.join(f"n{lower}", f"n{index}", sense=level if lower else count, context=level, **ends)
    if shape == "a node over many":
        made.add("top", Relay)
        for index in range(1, size):
            made.join(f"n{index}", "top", sense=level, context=level)
    return made


def lines(call: Callable[[], object]) -> int:
    """How many lines of Python a call runs; each turn of a loop counts."""
    ran = 0

    def trace(frame: FrameType, event: str, argument: object) -> Any:
        nonlocal ran
        ran += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return ran


def epochs(run: Iterator[object], number: int = EPOCHS) -> None:
    for _ in range(number):
        next(run)


WAYS: dict[str, dict[str, Any]] = {
    "barrier": {},
    "stale": {"staleness": 1},
    "free": {"staleness": None},
    "tasks": {"tasks": True},
    "delay": {"delay": 2},
    "rates": {"every": 2, "delay": 2},
}


@pytest.mark.parametrize("fields", WAYS.values(), ids=WAYS.keys())
@pytest.mark.parametrize("shape", SHAPES)
def test_an_epoch_costs_a_node_as_much_among_many(shape: str, fields: dict[str, Any]) -> None:
    """Fails where a delivery, or a turn, looks at all nodes or at all neighbours of one."""
    a_node = []
    for size in (FEW, MANY):
        run = SingleRun(described(shape, size, **fields).deployment(), epochs=None, seed=1).epochs()
        epochs(run, 2)
        a_node.append(lines(lambda: epochs(run)) / size)  # noqa: B023 - called at once
    few, many = a_node
    assert many < 1.5 * few, f"{many:.0f} lines a node for {MANY} nodes, {few:.0f} for {FEW}"


@pytest.mark.parametrize("shape", SHAPES)
def test_a_start_costs_a_node_as_much_among_many(shape: str) -> None:
    a_node = []
    for size in (FEW, MANY):
        given = described(shape, size)
        a_node.append(lines(lambda: SingleRun(given.deployment(), epochs=None, seed=1)) / size)  # noqa: B023
    few, many = a_node
    assert many < 1.3 * few, f"{many:.0f} lines a node for {MANY} nodes, {few:.0f} for {FEW}"


def test_the_formal_update_copies_no_states_for_each_node() -> None:
    roster = described("chain", FEW).deployment().roster
    active = ActiveHierarchy.initial(build_hierarchy(roster, OperatorSetting(), ANYTHING))
    before = dict(active.states)
    after = update(active)
    assert dict(active.states) == before
    assert after.epoch == 1
    assert after.states["n0"].belief["count"] == 1
    with pytest.raises(TypeError):
        after.states["n0"] = before["n0"]  # type: ignore[index]


class Compared(str):
    """A name that counts how often it is compared with another one."""

    count = 0

    def __lt__(self, other: object) -> bool:
        Compared.count += 1
        return str.__lt__(self, str(other))


def test_a_delivery_compares_no_names() -> None:
    """Sorting compares where no line of Python runs."""
    network = MemoryNetwork(seed=3)
    names = [Compared(f"n{index}") for index in range(50)]
    ports = {name: network.open_port(name) for name in names}
    for name in names:
        for kind in range(10):
            ports[name].send(Message(Header(OBSERVATIONS, names[kind], name, 1, 0, 0, 0, 0.0, b""), ()))
    Compared.count = 0
    received = 0
    while (name := network.next_receiver()) is not None:
        received += ports[name].receive() is not None
    assert received == 500
    assert Compared.count == 0


def test_among_many_mostly_those_that_came_last_have_their_turn() -> None:
    """A node of a tree has its next turn soon, where it has one in the epoch: caches still hold what it works on."""
    turns: list[str] = []
    run = SingleRun(described("tree", 4 * MANY).deployment(), epochs=None, seed=1, turn=turns.append).epochs()
    epochs(run)
    last: dict[str, int] = {}
    soon = 0
    for place, name in enumerate(turns):
        soon += place - last.get(name, -MANY) < MANY / 2
        last[name] = place
    assert soon > len(turns) / 4, "an order in which all are as likely has 0.17; all that could come soon are 0.44"


def test_who_has_waited_longest_has_its_turn_though_others_keep_coming() -> None:
    waiting: DrawnSet[int] = DrawnSet(Random(5))
    for one in range(10 * NEW):
        waiting.add(one)
    old = set(range(NEW))
    for later in range(10 * NEW, 1000 * NEW):
        drawn = waiting.draw_new()
        waiting.discard(drawn)
        old.discard(drawn)
        waiting.add(later)
    assert not old


def test_the_order_is_that_of_the_seed() -> None:
    def order(seed: int) -> list[str]:
        network = MemoryNetwork(seed)
        ports = {f"n{index}": network.open_port(f"n{index}") for index in range(12)}
        for sender in ports:
            for receiver in ports:
                ports[sender].send(Message(Header(OBSERVATIONS, sender, receiver, 1, 0, 0, 0, 0.0, b""), ()))
        found = []
        while (name := network.next_receiver()) is not None:
            message = ports[name].receive()
            assert message is not None
            found.append(f"{message.header.sender}->{name}")
        assert len(set(found)) == 144
        return found

    assert order(1) == order(1)
    assert order(1) != order(2)
