"""Processes are started, listened to until their end, and ended, alike for a launch and for who attaches to one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import anyio
import anyio.abc
import pytest
from support.deployments import write

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import Host, ProcessTerms
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.launch import child as child_module
from hierax.runtime.launch.attached_processes import AttachedProcesses
from hierax.runtime.launch.child import (
    Child,
    NodeProcess,
    Overheard,
    Overhearing,
    ProcessState,
    how_ended,
    start_process,
)
from hierax.runtime.launch.far_host import FarChild, FarHost, FarProcess
from hierax.runtime.launch.fork_server import UNKNOWN, ForkServer
from hierax.runtime.launch.frames import BEGIN, Frames, NodeOrder, frame
from hierax.runtime.launch.keeper import Keeper
from hierax.runtime.launch.keeper_link import Greeting
from hierax.runtime.launch.orders import LaunchOptions, Orders
from hierax.runtime.launch.process_supervisor import PAST, ProcessSupervisor
from hierax.schemas.errors import SchemaError


class Noting(ProcessSupervisor):
    """Notes what happens."""

    def __init__(self, tasks: anyio.abc.TaskGroup) -> None:
        super().__init__(tasks, Overhearing("0", lambda: 0), lambda name: ProcessTerms(), print, print)
        self.ends: list[tuple[str, ProcessState, str]] = []
        self.ended = anyio.Event()

        self.forks = ForkServer()

    def close(self) -> None:
        super().close()
        self.forks.close()

    async def _begin(self, orders: Sequence[NodeOrder]) -> list[Child]:
        return await start_process(orders, self.overhearing, self.forks)

    def _take(self, child: Child, value: dict[str, Any]) -> None:
        raise AssertionError(value)

    async def _on_end(self, child: Child) -> None:
        self.ends.append((child.name, child.state, str(child.last_words)))
        self.ended.set()


def order(folder: Path) -> NodeOrder:
    """An order of the toy deployment's world."""
    deployment = read_deployment(write(folder))
    orders = Orders(deployment, "0", "tcp/127.0.0.1:1", LaunchOptions(0, 1, folder))
    return orders.order("world", "w", BEGIN)


def test_a_process_that_ends_by_itself_is_heard_of_with_its_last_words(tmp_path: Path) -> None:
    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            supervisor = Noting(tasks)
            child = await supervisor.start(replace(order(tmp_path), modules=("nothing",)))
            assert (child.state, supervisor.child("w"), supervisor.children) == (ProcessState.STARTING, child, [child])
            with anyio.fail_after(60):
                await supervisor.ended.wait()
            ((name, state, why),) = supervisor.ends
            assert (name, state) == ("world", ProcessState.ENDED)
            assert "support" in why
            supervisor.close()
        supervisor.overhearing.close()

    anyio.run(main)


def test_a_process_that_is_ended_is_nobody_s_loss(tmp_path: Path) -> None:
    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            supervisor = Noting(tasks)
            child = await supervisor.start(order(tmp_path))
            with anyio.fail_after(60):
                await supervisor.end_all()
                await child.ended.wait()
            assert (child.state, child.alive, supervisor.ends) == (ProcessState.ENDED, False, [])
            supervisor.close()
        supervisor.overhearing.close()

    anyio.run(main)


def test_of_a_process_that_has_ended_no_descriptor_is_left(tmp_path: Path) -> None:
    """A run may have any number of them, one after the other."""

    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            supervisor = Noting(tasks)
            held: list[list[str]] = []
            for token in ("w", "w2", "w3"):
                child = await supervisor.start(replace(order(tmp_path), process=token, modules=("nothing",)))
                with anyio.fail_after(60):
                    await child.ended.wait()
                held.append(sorted(os.listdir("/proc/self/fd")))
                assert (child.alive, await child.say("anything")) == (False, False)
            assert held[0] == held[1] == held[2], "the first one begins what all have in common"
            supervisor.close()
        supervisor.overhearing.close()

    anyio.run(main)


def test_where_no_other_process_can_be_started_that_ends_it(tmp_path: Path) -> None:
    class Full(Noting):
        async def _on_end(self, child: Child) -> None:
            raise HieraxError("no process can be started")

    async def main() -> None:
        failures: list[str] = []
        failed = anyio.Event()

        def fail(error: Exception) -> None:
            failures.append(str(error))
            failed.set()

        async with anyio.create_task_group() as tasks:
            supervisor = Full(tasks)
            supervisor.fail = fail
            await supervisor.start(replace(order(tmp_path), modules=("nothing",)))
            with anyio.fail_after(60):
                await failed.wait()
            supervisor.close()
        supervisor.overhearing.close()
        assert failures == ["no process can be started"]

    anyio.run(main)


class Ended:
    """A process that has ended, though somebody goes on holding its pipes. `pid`: it was its number."""

    def __init__(self, pid: int, code: int) -> None:
        self.pid, self.returncode = pid, code

    async def wait(self) -> int:
        return self.returncode

    async def said(self) -> AsyncIterator[bytes]:
        await anyio.sleep_forever()
        yield b""


class Mute:
    """Prints nothing."""

    async def listen(self) -> None:
        return


class AnyHost:
    """A host beside the launch's."""

    class host:  # noqa: N801 - as an attribute
        name = "far"


async def take(data: bytes) -> None:
    raise AssertionError(data)


@pytest.fixture
def other(monkeypatch: pytest.MonkeyPatch) -> Iterator[subprocess.Popen[bytes]]:
    """Somebody else's program, which may have the number of a process that has ended."""
    monkeypatch.setattr(child_module, "END_TIMEOUT_S", 0.0)
    program = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"], start_new_session=True)
    yield program
    program.kill()
    program.wait()


@pytest.mark.parametrize(
    ("code", "signalled"), [(0, signal.SIGTERM), (-signal.SIGKILL, signal.SIGTERM), (UNKNOWN, signal.SIGKILL)]
)
def test_a_number_that_was_given_back_is_signalled_only_where_who_has_forked_it_was_lost(
    code: int, signalled: signal.Signals, other: subprocess.Popen[bytes]
) -> None:
    child = Child(cast(NodeOrder, None), cast(NodeProcess, Ended(other.pid, code)), cast(Overheard, Mute()))
    anyio.run(child.listen, take)
    other.terminate()
    assert other.wait() == -signalled


@pytest.mark.parametrize("code", [0, UNKNOWN])
def test_the_number_of_a_process_on_another_host_is_nobody_s_here(
    code: int, tmp_path: Path, other: subprocess.Popen[bytes]
) -> None:
    child = FarChild(order(tmp_path), cast(FarProcess, Ended(other.pid, code)), cast(FarHost, AnyHost()))
    anyio.run(child.listen, take)
    child.close()
    other.terminate()
    assert other.wait() == -signal.SIGTERM


def said(**fields: Any) -> bytes:
    return frame({"from": "w", **fields})


GARBLED = {
    "no frame": b"\xff" * 64,
    "no value": b"\x01\0\0\0\xc1",
    "no map": frame("hello"),
    "no status": said(),
    "of another process": frame({"from": "x", "status": "up"}),
    "no slot": said(status="keep", number=1, slot=7, data=b"x"),
    "no record": said(status="keep", number=1, slot=1, data="x"),
    "no line": said(status="failed"),
    "no reason": said(status="failed", message="x", where=5, final=False),
    "no process": said(status="misses", process={}),
    "no entry": said(status="append", kind={}, fields=["a"]),
    "no report": said(status="report", belief=None),
    "no figures": said(
        status="report", belief=0, policy="", actions=(), metrics={}, epoch=1, attempt=0, run=[1, "a", 0.0, 2]
    ),
}


@pytest.mark.parametrize("what", GARBLED)
def test_a_process_on_another_host_that_says_what_cannot_be_read_is_lost_and_nothing_else(
    what: str, tmp_path: Path
) -> None:
    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            told: list[Any] = []
            process = FarProcess("w", told.append)
            child = FarChild(order(tmp_path), process, cast(FarHost, AnyHost()))
            process.hear({"from": "w", "data": said(status="up")})
            process.hear({"from": "w", "data": GARBLED[what]})
            process.hear({"from": "w", "data": GARBLED[what]})  # nothing is made of what follows

            class Far(Noting):
                async def _begin(self, orders: Sequence[NodeOrder]) -> list[Child]:
                    return [child]

            supervisor = Far(tasks)
            notes: list[str] = []
            supervisor.notify = notes.append
            await supervisor.start(order(tmp_path))
            with anyio.fail_after(60):
                await supervisor.ended.wait()
            assert supervisor.ends == [("world", ProcessState.ENDED, "world: its process ended by signal SIGKILL")]
            assert (child.came_up, told) == (True, [{"signal": "w", "number": 9}])
            (note,) = notes
            assert note.startswith("world: its process on host far is killed: what it says cannot be read (")
            process.close()
            supervisor.close()
        supervisor.overhearing.close()

    anyio.run(main)


def test_of_processes_on_other_hosts_the_worlds_alone_tells_the_digests_of_a_run(tmp_path: Path) -> None:
    told = {"status": "append", "from": "w", "kind": "digests", "fields": [1, b"digest"]}
    world = replace(order(tmp_path), output=str(tmp_path / "out"))
    child = FarChild(world, cast(FarProcess, Ended(1, 0)), cast(FarHost, AnyHost()))
    assert child.take(told)
    child.close()
    written = (tmp_path / "out" / "digests.msgpack").read_bytes()
    assert b"digest" in written
    node = replace(world, name="left", owner=None, checkpoint=str(tmp_path / "left"))
    child = FarChild(node, cast(FarProcess, Ended(1, 0)), cast(FarHost, AnyHost()))
    with pytest.raises(SchemaError, match="expected numbers and bytes for states, got 'digests'"):
        child.take(told)
    assert child.take({**told, "kind": "states"})
    child.close()
    assert (tmp_path / "out" / "digests.msgpack").read_bytes() == written


def test_settings_that_cannot_be_read_any_more_are_told(tmp_path: Path) -> None:
    there = replace(order(tmp_path), settings=str(tmp_path / "gone.json5"))
    child = FarChild(there, cast(FarProcess, Ended(1, 0)), cast(FarHost, AnyHost()))
    greeting = Greeting("1", "2", "127.0.0.1", "127.0.0.1")
    with pytest.raises(HieraxError, match=r"gone\.json5: cannot be read: No such file or directory"):
        child.far_order(Host("robot", ("robot",)), greeting)
    child.close()


@pytest.mark.parametrize(
    "value",
    [
        "hello",
        5,
        {"printed": 5, "line": "x"},
        {"printed": "low"},
        {"started": "w", "pid": "x"},
        {"started": "w"},
        {"from": "w", "data": 5},
        {"from": {}, "data": b""},
        {"ended": "w", "code": "x"},
        {"ended": "w"},
    ],
)
def test_a_keeper_that_says_what_cannot_be_read_is_lost(value: Any, tmp_path: Path) -> None:
    """What `FarHost` makes of these errors is the loss of the host."""
    process = FarProcess("w", lambda value: None)
    child = FarChild(order(tmp_path), process, cast(FarHost, AnyHost()))
    far = FarHost.__new__(FarHost)  # without a link
    far._processes = {"w": [child]}
    overhearing = Overhearing("0", lambda: 0)
    with pytest.raises((SchemaError, KeyError)):
        far._take(value, overhearing)
    overhearing.close()
    process.end(0)
    process.close()
    child.close()


@pytest.mark.parametrize(("code", "how"), [(0, "with exit code 0"), (-9, "by signal SIGKILL"), (-35, "by signal 35")])
def test_how_a_process_has_ended_is_told_also_of_signals_without_a_name(code: int, how: str) -> None:
    assert how_ended(code) == how


def test_of_processes_that_are_past_the_last_ones_are_remembered(tmp_path: Path) -> None:
    """A node whose device is missing for weeks is started again any number of times."""

    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            supervisor = Noting(tasks)
            for number in range(3 * PAST):
                again = replace(order(tmp_path), process=f"w{number}")
                child = Child(again, cast(NodeProcess, Ended(1, 1)), cast(Overheard, Mute()), ProcessState.ENDED)
                child.ended.set()
                supervisor._children[child.token] = child
            supervisor._children["w1"].report = {"status": "report"}
            supervisor._children["w2"].state = ProcessState.RESTARTING
            supervisor._forget_past()
            last = [f"w{number}" for number in range(2 * PAST, 3 * PAST)]
            assert [child.token for child in supervisor.children] == ["w1", "w2", *last]
            supervisor.forks.close()
        supervisor.overhearing.close()

    anyio.run(main)


class Refusing:
    """Starts no process, as a system that has no room for one."""

    async def fork(self, writing: int, console: int) -> NodeProcess:
        raise HieraxError("no process can be started: Resource temporarily unavailable")


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_on_another_host_a_process_that_the_system_refuses_has_ended_and_no_other_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reading, writing = os.pipe()

    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            keeper = Keeper(tasks, -1, writing, cast(ForkServer, Refusing()))
            before = descriptors()
            await keeper._start([order(tmp_path)])
            assert descriptors() == before

    anyio.run(main)
    os.close(writing)
    assert Frames().feed(os.read(reading, 1 << 16)) == [{"ended": "w", "code": 1}]
    os.close(reading)
    assert capsys.readouterr().err == "hierax: world: no process can be started: Resource temporarily unavailable\n"


def test_who_attaches_to_a_launch_is_told_that_the_system_refuses_a_process(tmp_path: Path) -> None:
    failures: list[str] = []

    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            terms = {"world": ProcessTerms()}
            fail = lambda error: failures.append(str(error))  # noqa: E731 - noted where it is looked at
            attached = AttachedProcesses(tasks, [order(tmp_path)], terms, lambda order: "", print, fail)
            attached._forks.close()
            attached._forks = cast(ForkServer, Refusing())
            await attached.run()
            tasks.cancel_scope.cancel()
        attached.overhearing.close()

    anyio.run(main)
    assert failures == ["no process can be started: Resource temporarily unavailable"]
