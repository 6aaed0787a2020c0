"""What the supervisor of a launch knows of its processes, and of those that were started elsewhere."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, cast

import anyio

from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.launch.child import Child, ProcessState
from hierax.runtime.launch.frames import BEAT, FAILED, REPORT, UP, NodeOrder
from hierax.runtime.launch.hosts import Hosts
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.runtime.transport.hub import Hub
from hierax.schemas.control import Control, Lost


class Deployment:
    """With a world."""

    name = "toys"

    class roster:  # noqa: N801 - as an attribute
        world = "world"


class FewOrders:
    """Of that deployment."""

    run_id = "0"
    deployment = Deployment

    def terms(self, name: str) -> ProcessTerms:
        return ProcessTerms()


class DeafHub:
    """Hears of nobody."""

    def hears_of(self, process: str) -> bool:
        return False


class Process:
    """Lives, or has ended."""

    pid = 7
    returncode: int | None = None


class Order:
    """Of a node's process."""

    name, process, request = "top", "t", ""


def supervised(main: Callable[[RosterSupervisor], Awaitable[None]]) -> None:
    """Do something with a supervisor without processes."""

    def fail(why: Exception) -> None:
        raise why

    async def run() -> None:
        async with anyio.create_task_group() as tasks:
            orders, hub = cast(Orders, FewOrders()), cast(Hub, DeafHub())
            supervisor = RosterSupervisor(tasks, orders, hub, cast(Hosts, None), lambda what: None, fail)
            world = Child(cast(NodeOrder, Order()), cast(Any, Process()), cast(Any, None))
            supervisor.current["world"] = world
            await main(supervisor)
            supervisor.overhearing.close()

    anyio.run(run)


def beat(supervisor: RosterSupervisor, processes: dict[str, str], nodes: tuple[str, ...]) -> None:
    """The world's process says who there is."""
    numbers = dict.fromkeys(nodes, 0)
    said = {"status": BEAT, "epoch": 1, "version": 1, "instances": numbers, "processes": processes}
    supervisor._take(supervisor.current["world"], said)


def test_a_lost_node_that_is_kept_elsewhere_is_still_known_when_the_world_is_new() -> None:
    async def main(supervisor: RosterSupervisor) -> None:
        beat(supervisor, {"world": "w", "top": "t"}, ("world", "top"))
        beat(supervisor, {"world": "w2"}, ("world", "top"))
        assert supervisor.members == {"world": "w2", "top": "t"}
        beat(supervisor, {"world": "w2"}, ("world",))
        assert supervisor.members == {"world": "w2"}, "it was detached"

    supervised(main)


def test_a_process_that_goes_before_its_place_is_known_here_is_told_of() -> None:
    told: list[Control] = []

    async def main(supervisor: RosterSupervisor) -> None:
        async def send(word: Control) -> None:
            told.append(word)

        async def hear() -> None:
            beat(supervisor, {"world": "w", "top": "t"}, ("world", "top"))

        supervisor.send_to_owner = send  # type: ignore[method-assign]
        supervisor.hear_members = hear  # type: ignore[method-assign]
        beat(supervisor, {"world": "w"}, ("world",))
        assert supervisor.state("t") is ProcessState.ELSEWHERE
        await supervisor.on_gone("top", "t")
        assert supervisor.state("t") is ProcessState.CUT_OFF

    supervised(main)
    assert told == [Lost("top", "t", True)]


def test_a_process_is_in_one_state_after_the_other() -> None:
    child = Child(cast(NodeOrder, Order()), cast(Any, Process()), cast(Any, None))
    assert (child.state, child.came_up) == (ProcessState.STARTING, False)
    assert not child.take({"status": BEAT})
    assert child.take({"status": UP})
    assert (child.state, child.came_up) == (ProcessState.UP, True)
    assert child.take({"status": REPORT, "belief": None})
    assert (child.state, child.came_up) == (ProcessState.LEAVING, True)
    other = Child(cast(NodeOrder, Order()), cast(Any, Process()), cast(Any, None))
    assert other.take({"status": FAILED, "message": "no", "where": "", "final": False})
    assert (other.state, other.came_up, str(other.last_words)) == (ProcessState.LEAVING, False, "no")


def test_a_node_whose_process_ends_is_late_only_while_another_one_comes() -> None:
    async def main(supervisor: RosterSupervisor) -> None:
        child = supervisor.current["world"]
        late = {state: supervisor._is_late(child) for child.state in ProcessState for state in [child.state]}
        assert [state for state, is_late in late.items() if not is_late] == [ProcessState.UP]
        supervisor.begun.set()
        late = {state: supervisor._is_late(child) for child.state in ProcessState for state in [child.state]}
        assert [state for state, is_late in late.items() if not is_late] == [ProcessState.ENDED]
        child.came_up = True
        assert not any(supervisor._is_late(child) for child.state in ProcessState)

    supervised(main)


def test_of_a_process_whose_end_is_just_noticed_nobody_says_that_none_comes_for_it() -> None:
    """The world's process comes back at that moment: what is to become of the other one is not decided yet."""
    told: list[Control] = []

    async def main(supervisor: RosterSupervisor) -> None:
        async def send(word: Control) -> None:
            told.append(word)

        supervisor.send_to_owner = send  # type: ignore[method-assign]
        beat(supervisor, {"world": "w", "top": "t"}, ("world", "top"))
        child = Child(cast(NodeOrder, Order()), cast(Any, Process()), cast(Any, None))
        child.code = -9
        supervisor.current["top"] = supervisor._children["t"] = child
        await supervisor._send_deaths({"t": "t"})
        assert told == [Lost("top", "t", True)]
        child.state = ProcessState.ENDED
        child.ended.set()
        await supervisor._send_deaths({})
        assert told[1:] == [Lost("top", "", False)]

    supervised(main)
