"""Processes of nodes are forked from one: what they share with one another, and what follows when it is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import anyio
import pytest
from support.device_nodes import DEVICE, MOVES_S
from support.launched import Launched, command_of, is_alive, processes_below, run_here, said_here, until

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.launch import fork_server
from hierax.runtime.launch.fork_server import FORKING, UNKNOWN, ForkedProcess, ForkServer

EPOCHS = 400
NODES = ("arm", "eye", "spatial", "world")


def origin_of(launch: Launched) -> int:
    """What its nodes are forked from."""
    return next(pid for pid in processes_below(launch.process.pid) if FORKING in command_of(pid))


def pipes_of(pid: int) -> set[str]:
    """The pipes that a process holds open."""
    folder = Path(f"/proc/{pid}/fd")
    return {found for each in folder.iterdir() if (found := os.readlink(each)).startswith("pipe:")}


def device(folder: Path) -> Path:
    """The file of a deployment whose world has a device."""
    file = folder / "device.yaml"
    text = DEVICE.format(log=folder / "device.log", on_uncertain_act="repeat", deadline_s="null", eye="")
    file.write_text(text, encoding="utf-8")
    return file


def test_nodes_outlive_what_they_were_forked_from_and_others_are_forked_from_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = device(tmp_path)
    wanted = run_here(str(file), "--epochs", str(EPOCHS))["digest"]
    monkeypatch.setenv(MOVES_S, "0.01")
    with Launched(tmp_path, str(file), "--epochs", str(EPOCHS)) as launch:
        launch.until_epoch(5)
        first, origin = {name: launch.until_pid(name) for name in NODES}, origin_of(launch)
        os.kill(origin, signal.SIGKILL)
        epoch = launch.epoch
        until(lambda: launch.epoch > epoch + 5, "epochs without what the nodes were forked from")
        assert {name: launch.pid(name) for name in NODES} == first
        launch.kill("spatial")
        assert launch.until_pid("spatial", other_than=first["spatial"])
        assert origin_of(launch) != origin
        launch.end()
        assert launch.process.returncode == 0, launch.err
        assert launch.written[EPOCHS].hex() == wanted
        assert launch.err.count("it is started again") == 1, launch.err


def test_a_node_that_cannot_end_by_itself_does_not_outlive_a_launch_that_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is stopped hears nothing of it, nor does one whose interpreter a library in C holds."""
    file = device(tmp_path)
    monkeypatch.setenv(MOVES_S, "0.01")
    with Launched(tmp_path, str(file), "--epochs", "100000") as launch:
        launch.until_epoch(5)
        pids = [launch.until_pid(name) for name in NODES]
        handle = os.pidfd_open(pids[0])  # which is not another process later
        os.kill(pids[0], signal.SIGSTOP)
        try:
            launch.process.kill()
            until(lambda: not any(map(is_alive, pids)), "the nodes' end")
        finally:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(handle, signal.SIGKILL)
            os.close(handle)


STARTS = """\
hierarchy: two
world: clock
epochs: 1000000
nodes:
  clock: {class: "support.slow_nodes:Clock"}
  node: {class: "support.slow_nodes:Starting"}
edges:
  clock -> node: {sense: "support.slow_nodes:number"}
"""


def test_what_a_node_has_started_ends_with_it_though_the_supervisor_hears_of_it_later(tmp_path: Path) -> None:
    """By then the number of its process may be that of somebody else's."""
    file = tmp_path / "two.yaml"
    file.write_text(STARTS, encoding="utf-8")
    with Launched(tmp_path, str(file)) as launch:
        launch.until_said("node: ")
        program = next(int(line.removeprefix("node: ")) for _, line in launch.said if line.startswith("node: "))
        launch.process.send_signal(signal.SIGSTOP)
        try:
            launch.kill("node")
            until(lambda: not is_alive(program), "the program's end")
        finally:
            launch.process.send_signal(signal.SIGCONT)
        launch.until_said("node: its process ended by signal SIGKILL")


def test_nodes_have_their_own_streams_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe that another process held open would never end."""
    file = device(tmp_path)
    monkeypatch.setenv(MOVES_S, "0.01")
    with Launched(tmp_path, str(file), "--epochs", "100000") as launch:
        launch.until_epoch(5)
        launch.kill("eye")
        launch.until_epoch(launch.epoch + 5)
        console = os.readlink(f"/proc/{launch.process.pid}/fd/2")
        held = [pipes_of(launch.until_pid(name)) - {console} for name in NODES]
        assert all(len(pipes) >= 3 for pipes in held), held  # orders, status, what is printed
        for at, pipes in enumerate(held):
            for others in held[:at]:
                assert not pipes & others


def test_what_cannot_fork_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_server, "python_module", lambda module, *rest: [sys.executable, "-c", "pass"])

    async def ask() -> None:
        with ForkServer() as forks, anyio.fail_after(60):
            await forks.fork(2, 2)

    with pytest.raises(HieraxError, match="no process can be started"):
        anyio.run(ask)


REFUSES = """\
import errno, os
from hierax.runtime.launch import forking
fork, left = os.fork, list(range({times}))
def refuse_or_fork():
    if left:
        left.pop()
        raise OSError(errno.EAGAIN, "no")
    return fork()
os.fork = refuse_or_fork
forking.main()
"""


def refusing(times: int) -> Callable[..., list[str]]:
    """What starts a fork server to which the system refuses so many processes."""
    return lambda module, *rest: [sys.executable, "-c", REFUSES.format(times=times), *rest]


def test_a_process_that_the_system_refuses_is_told_and_others_are_forked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_server, "python_module", refusing(1))

    async def ask() -> None:
        with ForkServer() as forks, anyio.fail_after(60):
            with pytest.raises(HieraxError, match="no process can be started: Resource temporarily unavailable"):
                await forks.fork(2, 2)
            forked = await forks.fork(2, 2)
            forked.close()

    anyio.run(ask)


def test_a_launch_whose_processes_the_system_refuses_ends_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fork_server, "python_module", refusing(1000))
    done = said_here("launch", "servo", "--epochs", "2", folder=tmp_path)
    assert done.returncode == 1, done.stderr
    assert done.stderr == "error: no process can be started: Resource temporarily unavailable\n"


def test_what_has_forked_nothing_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A launch that is refused would else wait until it has imported what nobody needs."""
    killed: list[int] = []

    class Endless(subprocess.Popen[bytes]):
        def kill(self) -> None:
            killed.append(self.pid)
            super().kill()

        def wait(self, timeout: float | None = None) -> int:
            assert self.pid in killed, "it is waited for"
            return super().wait(timeout)

    endless = [sys.executable, "-c", "import signal; signal.pause()"]
    monkeypatch.setattr(fork_server, "python_module", lambda module, *rest: endless)
    monkeypatch.setattr(subprocess, "Popen", Endless)
    with ForkServer().start():
        pass
    assert len(killed) == 1


def test_what_is_given_up_counts_as_ended_and_is_told_nothing_more() -> None:
    """Its descriptors' numbers may be those of something else from then on."""

    refused: list[str] = []

    async def send(forked: ForkedProcess) -> None:
        try:
            await forked.send(bytes(1 << 21))  # more than a pipe holds
        except BrokenPipeError as error:
            refused.append(str(error))

    async def main() -> None:
        with ForkServer() as forks, anyio.fail_after(60):
            forked = await forks.fork(2, 2)
            forked.send_signal(signal.SIGSTOP)
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(send, forked)
                await anyio.wait_all_tasks_blocked()
                assert forked.returncode is None
                forked.close()
            reading, writing = os.pipe()
            assert forked.returncode == await forked.wait() == UNKNOWN
            await send(forked)
            os.kill(forked.pid, signal.SIGKILL)
            os.close(reading)
            os.close(writing)

    anyio.run(main)
    assert len(refused) == 2
