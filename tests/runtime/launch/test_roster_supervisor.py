"""What the supervisor of a launch knows of its processes, and of those that were started elsewhere."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.launch import roster_supervisor
from hierax.runtime.launch.child import Child, ProcessState, Restarts
from hierax.runtime.launch.frames import (
    ANSWER,
    BEAT,
    COME_BACK,
    DISMISSED,
    FAILED,
    FINISHED,
    REPORT,
    ROSTER,
    STOP,
    UP,
    Frames,
    NodeOrder,
)
from hierax.runtime.launch.hosts import Hosts
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.runtime.transport.hub import Hub
from hierax.schemas.control import Control, Dismiss, Lost, Propose, decode_control, encode_control
from hierax.schemas.roster import Detach, Reference, Roster


class Deployment:
    """With a world."""

    name = "toys"

    class roster:  # noqa: N801 - as an attribute
        world = "world"


class FewOrders:
    """Of that deployment."""

    run_id = "0"
    deployment = Deployment
    left = None

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

    name, process, request, life, shares, checkpoint = "top", "t", "", COME_BACK, "", ""


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


def test_whose_world_dies_with_the_last_epoch_still_has_all_its_nodes_report() -> None:
    """The next process of the world's says that it has finished, and knows of few any more."""
    roster = Roster(
        nodes={name: Reference(f"a:{name}", {}) for name in ("world", "low", "top")}, edges=(), world="world"
    )

    async def main(supervisor: RosterSupervisor) -> None:
        supervisor.current["low"] = low = Child(cast(NodeOrder, Order()), cast(Any, Process()), cast(Any, None))
        supervisor.instances = {"top": 1}
        supervisor.members = {"top": "t"}  # kept elsewhere
        world = supervisor.current["world"]
        said = {"status": FINISHED, "epoch": 60, "processes": {}, "roster": roster.plain()}
        supervisor._take(world, said)
        assert supervisor.present == [low, world]
        assert supervisor.finished.is_set()

    supervised(main)


def test_who_comes_back_is_stopped_with_the_last_roster() -> None:
    told: list[Any] = []

    class Listens(Process):
        async def send(self, data: bytes) -> None:
            told.extend(Frames().feed(data))

    async def main(supervisor: RosterSupervisor) -> None:
        child = Child(cast(NodeOrder, Order()), cast(Any, Listens()), cast(Any, None))
        await supervisor.stop(child)
        roster = Roster("world", {"world": Reference("a:world")}, ())
        said = {"status": FINISHED, "epoch": 60, "processes": {}, "roster": roster.plain()}
        supervisor._take(supervisor.current["world"], said)
        await supervisor.stop(child)

    supervised(main)
    assert [command for _, command in told] == [{STOP: 0}, {STOP: 60, ROSTER: told[1][1][ROSTER]}]
    assert Roster.read(told[1][1][ROSTER]).world == "world"


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


def test_what_is_kept_goes_though_its_process_has_ended_before_it_is_known_here_that_it_was_replaced(
    tmp_path: Path,
) -> None:
    """The world's process and the one that is replaced say so by pipes of their own."""
    kept = [tmp_path / f"top.{ending}" for ending in ("0", "1", "lock")]
    for path in kept:
        path.touch()

    class Replaced(Order):
        checkpoint = str(tmp_path / "top")

    class Adopting(FewOrders):
        adopted = False

        def is_kept(self, order: NodeOrder) -> bool:
            return not self.adopted

        def adopt(self, request: str, terms: Mapping[str, ProcessTerms]) -> None:
            self.adopted = True

        def save(self, coming: Mapping[str, Mapping[str, ProcessTerms]]) -> None:
            pass

    class Ended(Process):
        returncode = 0

    async def main(supervisor: RosterSupervisor) -> None:
        async def send(word: Control) -> None:
            pass

        supervisor.send_to_owner = send  # type: ignore[method-assign]
        supervisor.orders = cast(Orders, Adopting())
        supervisor.changes.add(Propose("c0ffee", Detach("top").plain()), {})
        beat(supervisor, {"world": "w", "top": "t"}, ("world", "top"))
        child = Child(cast(NodeOrder, Replaced()), cast(Any, Ended()), cast(Any, None))
        child.take({"status": DISMISSED, "why": "another process runs it"})
        await supervisor._on_ends([child])
        await anyio.wait_all_tasks_blocked()
        beat(supervisor, {"world": "w", "top": "t"}, ("world", "top"))
        assert all(path.exists() for path in kept)
        supervisor._take(
            supervisor.current["world"], {"status": ANSWER, "request": "c0ffee", "epoch": 7, "refusal": ""}
        )
        beat(supervisor, {"world": "w", "top": "t2"}, ("world", "top"))
        assert list(tmp_path.iterdir()) == []

    supervised(main)


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


class Counted:
    """What a supervisor does about processes of a node that have ended, of which none but their ends is real.

    Attributes:
        said: to people.
        told: to the owner.
        started: the processes that come in their place.
    """

    def __init__(self, supervisor: RosterSupervisor) -> None:
        self.said: list[str] = []
        self.told: list[Control] = []
        self.started: list[Child] = []
        self._supervisor = supervisor
        supervisor.notify = self.said.append
        supervisor.send_to_owner = self._tell  # type: ignore[method-assign]
        supervisor._hosts = cast(Hosts, self)
        supervisor._listen = self._listen  # type: ignore[method-assign]
        supervisor.orders.again = self._again  # type: ignore[method-assign]
        supervisor.begun.set()

    def killed(self) -> Child:
        """A process of the node that somebody has killed."""
        child = Child(cast(NodeOrder, Order()), cast(Any, Process()), cast(Any, None), came_up=True, code=-9)
        self._supervisor._children["t"] = child
        self._supervisor._restarts["top"] = Restarts(ProcessTerms(restart_delay_s=0.0))
        return child

    async def ends(self, child: Child) -> None:
        """It ends, while at every turn of the event loop the world says that it is there, and asks who is dead."""
        supervisor = self._supervisor
        supervisor.tasks.start_soon(supervisor._on_ends, [child])
        while not self.started:
            await anyio.sleep(0)
            beat(supervisor, {"world": "w", "top": "t"}, ("world", "top"))
            if supervisor.current.get("top") is child:
                await supervisor._send_deaths({})

    async def start(self, orders: Sequence[NodeOrder], overhearing: object) -> list[Child]:
        """As `Hosts` does."""
        self.started += [Child(order, cast(Any, Process()), cast(Any, None)) for order in orders]
        return self.started[-len(orders) :]

    async def ready(self, name: str) -> None:
        """As `Hosts` does."""

    async def _tell(self, word: Control) -> None:
        self.told.append(word)
        await anyio.sleep(0)

    async def _listen(self, children: Sequence[Child]) -> None:
        """Nothing is said."""

    def _again(self, order: NodeOrder, token: str, *rest: object) -> NodeOrder:
        again = Order()
        again.process = token
        return cast(NodeOrder, again)


def test_one_process_comes_in_the_place_of_one_whenever_the_world_says_who_there_is() -> None:
    """It knows no better for a while; what is done about the end is begun in the moment that it is known."""
    counted: list[Counted] = []

    async def main(supervisor: RosterSupervisor) -> None:
        counted.append(Counted(supervisor))
        child = supervisor.current["top"] = counted[0].killed()
        await counted[0].ends(child)

    supervised(main)
    assert counted[0].said == ["top: its process ended by signal SIGKILL; it is started again"]
    assert counted[0].told == [Lost("top", "t", True)]
    assert len(counted[0].started) == 1


def test_one_process_comes_in_the_place_of_one_that_ends_as_it_is_taken_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(roster_supervisor, "BEAT_S", 0.02)
    counted: list[Counted] = []

    async def main(supervisor: RosterSupervisor) -> None:
        counted.append(Counted(supervisor))
        await counted[0].ends(counted[0].killed())

    supervised(main)
    assert counted[0].said == ["top: its process ended by signal SIGKILL; it is started again"]
    assert set(counted[0].told) == {Lost("top", "t", True)}
    assert len(counted[0].started) == 1


def test_what_is_asked_for_while_the_worlds_next_process_is_started_reaches_that_one() -> None:
    """Its order was written before, and the process that it was sent to had ended."""
    told: list[Any] = []

    class Listens(Process):
        async def send(self, data: bytes) -> None:
            told.extend(command for _, command in Frames().feed(data))

    class WorldsOrder(Order):
        name = "world"

    class Starting(Counted):
        async def start(self, orders: Sequence[NodeOrder], overhearing: object) -> list[Child]:
            supervisor.changes.add(proposal, {})
            await RosterSupervisor.send_to_owner(supervisor, proposal)
            return [Child(order, cast(Any, Listens()), cast(Any, None)) for order in orders]

        def _again(self, order: NodeOrder, token: str, *rest: object) -> NodeOrder:
            return cast(NodeOrder, WorldsOrder())

    supervisor: RosterSupervisor
    proposal = Propose("c0ffee", Detach("top").plain(), {}, {}, ())

    async def main(given: RosterSupervisor) -> None:
        nonlocal supervisor
        supervisor = given
        Starting(supervisor)
        world = supervisor.current["world"] = Child(
            cast(NodeOrder, WorldsOrder()), cast(Any, Process()), cast(Any, None), came_up=True, code=-9
        )
        await supervisor._restart([world])

    supervised(main)
    assert told == [encode_control(proposal)]


def test_a_change_that_is_refused_leaves_no_process_that_was_started_for_it() -> None:
    """One of them has ended, and the owner has not heard of the other, or is a new one."""
    told: list[tuple[str, Any]] = []

    class Listens(Process):
        async def send(self, data: bytes) -> None:
            told.extend(Frames().feed(data))

    def newcomer(supervisor: RosterSupervisor, name: str, request: str) -> None:
        order = cast(NodeOrder, SimpleNamespace(name=name, process=f"{name}.1", request=request))
        supervisor._children[f"{name}.1"] = Child(order, cast(Any, Listens()), cast(Any, None))

    async def main(supervisor: RosterSupervisor) -> None:
        supervisor.members = {"world": "w"}
        for name, request in (("low", "c1"), ("high", "c1"), ("top", "c2")):
            newcomer(supervisor, name, request)
        supervisor._children["low.1"].code = 1
        supervisor.changes.add(Propose("c1", Detach("top").plain()), {})
        said = {"status": ANSWER, "request": "c1", "epoch": 0, "refusal": "low: no camera"}
        supervisor._take(supervisor.current["world"], said)

    supervised(main)
    assert [(token, decode_control(word)) for token, word in told] == [("high.1", Dismiss("low: no camera"))]


def test_a_disk_that_is_full_when_a_change_is_made_ends_no_run_and_is_told_once() -> None:
    done: list[str] = []
    room = iter((False, False, True, True))

    class Full(FewOrders):
        def adopt(self, request: str, terms: Mapping[str, ProcessTerms]) -> None:
            done.append(f"{request} is adopted")

        def outdate(self) -> None:
            done.append("what was written is outdated")

        def save(self, coming: Mapping[str, Mapping[str, ProcessTerms]]) -> None:
            if not next(room):
                raise HieraxError("run.json: cannot be written: No space left on device")

    async def main(supervisor: RosterSupervisor) -> None:
        supervisor.orders = cast(Orders, Full())
        supervisor.notify = done.append
        supervisor.changes.add(Propose("c0ffee", Detach("top").plain()), {})
        said = {"status": ANSWER, "request": "c0ffee", "epoch": 7, "refusal": ""}
        supervisor._take(supervisor.current["world"], said)
        for _ in range(3):
            beat(supervisor, {}, ())

    supervised(main)
    assert done == [
        "c0ffee is adopted",
        "what was written is outdated",
        "run.json: cannot be written: No space left on device; until it is, the run cannot be resumed",
        "what it takes to resume the run is written again",
    ]
    assert next(room), "there was no reason to write it once more"


@pytest.mark.parametrize(
    ("terms", "why"),
    [
        (ProcessTerms(restart_policy="never"), "restart_policy: never"),
        (ProcessTerms(max_restarts=1), "max_restarts: 1 in 60 s"),
        (ProcessTerms(max_restarts=1, restart_window_s=None), "max_restarts: 1"),
    ],
)
def test_what_is_not_started_again_says_how_it_ended_and_by_which_terms(terms: ProcessTerms, why: str) -> None:
    order = Order()
    child = Child(cast(NodeOrder, order), cast(Any, Process()), cast(Any, None), came_up=True, code=-9)
    child.culprit = "it is in observe of top in epoch 7, past the deadline"
    restarts = Restarts(terms)
    while restarts.delay_s(child) is not None:
        pass
    assert str(child.not_started_again(restarts.refused)) == (
        f"top: its process ended by signal SIGKILL ({child.culprit}); it is not started again ({why})"
    )
