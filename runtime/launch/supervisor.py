"""Launching a deployment: each node its own process, watched until the run is over."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from secrets import token_hex
from typing import Any

import anyio
import anyio.abc

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.files import write_roster
from hierax.runtime.launch.pipe import FAILED, FINISHED, REPORT, STOP, UP, Frames, NodeOrder, frame
from hierax.runtime.report import NodeReport, Report, make_report
from hierax.runtime.transport.hub import Hub
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

END_TIMEOUT_S = 1.5
"""How long processes may take to end when the run is broken off."""

CLOSED = -1
"""A child's handle when the child is gone."""

REPORT_TIMEOUT_S = 60.0
"""How long they may take for their reports, and their probes to close, when it is over."""


class Interrupted(Exception):  # noqa: N818 - no error: somebody pressed Ctrl-C
    """The run was broken off by a signal."""


class NodeFailedError(HieraxError):
    """A node's process failed or ended before the run was over.

    Attributes:
        where: path in the roster of what could not be loaded; may be empty.
    """

    def __init__(self, message: str, where: str = "") -> None:
        self.where = where
        super().__init__(message)


@dataclass
class Child:
    """A node's process and what it has said.

    Attributes:
        name: of the node.
        process: its process.
        handle: a file descriptor that stands for it; signals go through it, as it never means
            another process, and as asyncio's own way competes with its wait for the exit code.
        up: set when it and its neighbours hear each other.
        heard: set when all that it had to say is taken in and it has ended.
        report: its last word.
        failure: why it cannot go on.
    """

    name: str
    process: anyio.abc.Process
    handle: int
    up: anyio.Event = field(default_factory=anyio.Event)
    heard: anyio.Event = field(default_factory=anyio.Event)
    report: dict[str, Value] | None = None
    failure: NodeFailedError | None = None


def launch(
    deployment: Deployment,
    *,
    epochs: int | None,
    seed: int,
    output: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> Report:
    """Run a deployment with each node in a process of its own, over Zenoh.

    Args:
        deployment: what to run.
        epochs: how many; None: the deployment's number, or until the world has finished.
        seed: of all random numbers.
        output: folder for the states, digests and what probes write; None: nothing is written.
        progress: told the number of each epoch that is committed, as far as one can be told without
            holding the run up.

    Raises:
        HieraxError: a node cannot be loaded, did not come up in time, or failed.
        KeyboardInterrupt: broken off by SIGINT, SIGTERM or SIGHUP; all processes are gone.
    """
    if output is not None:
        write_roster(output, deployment.roster)
    try:
        supervisor = Supervisor(deployment, deployment.epochs if epochs is None else epochs, seed, output)
        return anyio.run(supervisor.run, progress)
    except Interrupted as error:
        raise KeyboardInterrupt from error
    finally:
        remove_orphaned_segments()


class Supervisor:
    """Starts the processes of a launch, watches them, and ends them."""

    def __init__(self, deployment: Deployment, epochs: int | None, seed: int, output: Path | None) -> None:
        self._deployment = deployment
        self._epochs = epochs
        self._seed = seed
        self._output = output
        self._run_id = token_hex(4)
        self._children: dict[str, Child] = {}
        self._finished = anyio.Event()
        self._broken = anyio.Event()
        self._why: Exception | None = None
        self._ending = False

    async def run(self, progress: Callable[[int], None] | None) -> Report:
        """The whole launch."""
        begun = time.perf_counter()
        keys = Keys(self._deployment.name, self._run_id)
        hub = Hub(keys, self._deployment.zenoh, progress)
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(self._watch_signals)
                try:
                    await self._start_all(tasks, hub.endpoint)
                    start_s = await self._until_finished(begun)
                    await self._collect()
                finally:
                    with anyio.CancelScope(shield=True):
                        await self._end_all()
                    tasks.cancel_scope.cancel()
        finally:
            hub.close()
        if self._why is not None:
            raise self._why
        return self._make_report(start_s)

    async def _start_all(self, tasks: anyio.abc.TaskGroup, hub: str) -> None:
        for name in sorted(self._deployment.roster.nodes):
            process = await anyio.open_process(
                [sys.executable, "-m", "hierax.runtime.launch.node_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=None,
                start_new_session=True,
            )
            child = self._children[name] = Child(name, process, os.pidfd_open(process.pid))
            tasks.start_soon(self._listen, child)
            await self._tell(child, self._order(name, hub).plain())
            if self._broken.is_set():
                return

    def _order(self, name: str, hub: str) -> NodeOrder:
        deployment = self._deployment
        return NodeOrder(
            name=name,
            deployment=deployment.name,
            run=self._run_id,
            roster=deployment.roster,
            seed=self._seed,
            epochs=self._epochs,
            hub=hub,
            settings=deployment.zenoh,
            output="" if self._output is None else str(self._output),
            probes=deployment.probes,
            import_paths=tuple(deployment.import_paths),
        )

    async def _tell(self, child: Child, value: Value) -> None:
        assert child.process.stdin is not None
        try:
            await child.process.stdin.send(frame(value))
        except (anyio.BrokenResourceError, anyio.ClosedResourceError, OSError):
            self._break(NodeFailedError(f"{child.name}: its process does not listen any more"))

    async def _listen(self, child: Child) -> None:
        """Take in what a child says until its process ends."""
        assert child.process.stdout is not None
        frames = Frames()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_cut_off, child, tasks.cancel_scope)
            async for data in child.process.stdout:
                for value in frames.feed(data):
                    self._take(child, value)
            with anyio.move_on_after(END_TIMEOUT_S):
                await child.process.wait()
            tasks.cancel_scope.cancel()
        code = child.process.returncode
        child.heard.set()
        if child.report is None and not self._ending:
            self._break(child.failure or NodeFailedError(f"{child.name}: its process ended {_describe(code)}"))

    def _take(self, child: Child, value: dict[str, Any]) -> None:
        status = value["status"]
        if status == UP:
            child.up.set()
        elif status == FINISHED:
            self._finished.set()
        elif status == REPORT:
            child.report = value
        elif status == FAILED:
            child.failure = NodeFailedError(value["message"], value["where"])
            self._break(child.failure)

    def _break(self, why: Exception) -> None:
        if self._why is None and not self._ending:
            self._why = why
            self._broken.set()

    async def _watch_signals(self) -> None:
        """The first signal ends the run in good order, the second one at once."""
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
            numbers.append(signal.SIGHUP)
        with anyio.open_signal_receiver(*numbers) as signals:
            async for _ in signals:
                if self._broken.is_set() or self._ending:
                    self._kill_all()
                    await self._wait_for_all()
                    remove_orphaned_segments()
                    os._exit(130)
                self._break(Interrupted())

    async def _until_finished(self, begun: float) -> float:
        """Wait for the processes to come up, then for the world to finish.

        Returns:
            Seconds from the launch until all were up.
        """
        timeout_s = self._deployment.start_timeout_s
        start_s = 0.0
        async with self._unless_broken():
            with anyio.move_on_after(timeout_s):
                for child in self._children.values():
                    await child.up.wait()
            late = [name for name, child in self._children.items() if not child.up.is_set()]
            if late:
                self._break(NodeFailedError(f"not up within {timeout_s:g} s (start_timeout_s): {', '.join(late)}"))
            start_s = time.perf_counter() - begun
            await self._finished.wait()
        return start_s

    async def _collect(self) -> None:
        """Have every process report and end."""
        async with self._unless_broken():
            with anyio.move_on_after(REPORT_TIMEOUT_S):
                for child in self._children.values():
                    await self._tell(child, STOP)
                for child in self._children.values():
                    await child.heard.wait()
            silent = [name for name, child in self._children.items() if child.report is None]
            if silent:
                self._break(NodeFailedError(f"no report within {REPORT_TIMEOUT_S:g} s: {', '.join(silent)}"))

    @asynccontextmanager
    async def _unless_broken(self) -> AsyncIterator[None]:
        """Break off what is waited for inside when the run breaks; nothing is done in there when it has."""
        async with anyio.create_task_group() as tasks:

            async def watch() -> None:
                await self._broken.wait()
                tasks.cancel_scope.cancel()

            tasks.start_soon(watch)
            if self._broken.is_set():
                tasks.cancel_scope.cancel()
            yield
            tasks.cancel_scope.cancel()

    async def _end_all(self) -> None:
        """End every process that is left: first kindly, then not."""
        self._ending = True
        for child in self._children.values():
            _signal(child, signal.SIGTERM)
        await self._wait_for_all()
        self._kill_all()
        await self._wait_for_all()
        for child in self._children.values():
            for stream in (child.process.stdin, child.process.stdout):
                if stream is not None:
                    await stream.aclose()
        for child in self._children.values():
            os.close(child.handle)
            child.handle = CLOSED

    async def _wait_for_all(self) -> None:
        """Bounded, as a program that a node has started may hold its pipes open when the node is gone."""
        with anyio.move_on_after(END_TIMEOUT_S):
            for child in self._children.values():
                await child.process.wait()

    def _kill_all(self) -> None:
        for child in self._children.values():
            if child.process.returncode is None:  # it still stands for its group
                _signal_group(child, signal.SIGKILL)
            _signal(child, signal.SIGKILL)

    def _make_report(self, start_s: float) -> Report:
        reports = {name: child.report for name, child in self._children.items() if child.report is not None}
        epochs, digest, wall_s, epochs_s = reports[self._deployment.roster.world]["run"]
        nodes = {
            name: NodeReport(said["belief"], said["policy"], said["actions"], said["metrics"])
            for name, said in reports.items()
        }
        return make_report(
            self._deployment.name,
            "launch",
            self._seed,
            epochs,
            digest,
            wall_s,
            epochs_s,
            nodes,
            self._output,
            start_s=start_s,
        )


def _signal(child: Child, number: signal.Signals) -> None:
    if child.handle == CLOSED:
        return
    try:
        signal.pidfd_send_signal(child.handle, number)
    except ProcessLookupError:
        return  # it has ended by itself


def _signal_group(child: Child, number: signal.Signals) -> None:
    """A node's process leads a group, with the programs that the node has started."""
    try:
        os.killpg(child.process.pid, number)
    except ProcessLookupError:
        return  # all have ended by themselves


async def _cut_off(child: Child, listening: anyio.CancelScope) -> None:
    """End what a node has started with the node: it may hold the pipes open, so that no end of them comes."""
    await anyio.wait_readable(child.handle)  # the process has ended
    _signal_group(child, signal.SIGKILL)
    await anyio.sleep(END_TIMEOUT_S)
    listening.cancel()


def _describe(code: int | None) -> str:
    if code is None:
        return "without an exit code"
    return f"by signal {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
