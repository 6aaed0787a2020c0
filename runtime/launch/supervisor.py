"""Launching a deployment: each node its own process, kept alive until the run is over."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from secrets import token_hex

import anyio
import anyio.abc

from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.execution.breaker import ending_signals, leave_at_once
from hierax.runtime.execution.output_folder import write_roster
from hierax.runtime.execution.report import Interrupted, NodeReport, Report, make_report
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, NodeFailedError
from hierax.runtime.launch.early_end import CLOSE_S, EarlyEnd
from hierax.runtime.launch.frames import (
    BEGIN,
    COME_BACK,
    STOP,
)
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.process_supervisor import ProcessSupervisor
from hierax.runtime.launch.recorder_process import RecorderChild, Wanted
from hierax.runtime.launch.run_file import Run, Running, make_state, register
from hierax.runtime.transport.hub import Hub
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments, shared_memory_fault
from hierax.runtime.watch.logs import begin_log
from hierax.schemas.keys import Keys
from hierax.schemas.roster import Roster
from hierax.schemas.values import Value

REPORT_TIMEOUT_S = 60.0
"""How long they may take for their reports, and their probes to close, when it is over."""

POLL_S = 0.01


class _BrokenOff(Exception):  # noqa: N818 - no error: somebody pressed Ctrl-C
    """The run was broken off by a signal."""


def launch(
    deployment: Deployment,
    *,
    epochs: int | None,
    seed: int,
    output: Path | None = None,
    progress: Callable[[int], None] | None = None,
    tell: Callable[[str], None] | None = None,
    state: Path | None = None,
    run: Run | None = None,
    host: str | None = None,
    settings: Sequence[str] = (),
    faults: Mapping[str, Sequence[str]] | None = None,
    record: Wanted | None = None,
) -> Report:
    """Run a deployment with each node in a process of its own, over Zenoh.

    Args:
        deployment: what to run.
        epochs: how many; None: the deployment's number, or until the world has finished.
        seed: of all random numbers.
        output: folder for the states, digests and what probes write; None: nothing is written.
        progress: told the number of each epoch that is committed, as far as one can be told without
            holding the run up.
        tell: told what happens to the processes.
        state: folder of the checkpoints, which stays; None: one that goes with the run.
        run: go on with this one, whose checkpoints are in `state`.
        host: address of this machine at which processes on others may join; None: none may.
        settings: with which the deployment file was read, for those who read it again.
        faults: by node, where its processes kill themselves, one after the other; see `hierax.runtime.launch.faults`.
        record: whether and where it is recorded; told how that ended.

    Raises:
        HieraxError: a node cannot be loaded, did not come up in time, or failed.
        Interrupted: broken off by SIGINT, SIGTERM or SIGHUP; all processes are gone.
        KeyboardInterrupt: likewise, before all nodes were up.
    """
    with ExitStack() as stack:
        stack.callback(remove_orphaned_segments)
        if state is None:
            state = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hierax-")))
        make_state(state)
        if output is not None and run is None:
            write_roster(output, deployment.roster)
        limit = deployment.epochs if epochs is None else epochs
        run_id = token_hex(4)
        orders = Orders(deployment, run_id, seed, limit, output, state, host, settings, faults)
        if run is not None:
            orders.take_up(run)
        roster = deployment.roster if run is None else orders.known_roster()
        orders.keep()
        supervisor = Supervisor(
            deployment, roster, orders, Keys(deployment.name, run_id), tell or _say_nothing, run is not None, record
        )
        try:
            report = anyio.run(supervisor.run, progress)
        except _BrokenOff as error:
            raise KeyboardInterrupt from error
        if supervisor.early is not None:
            raise Interrupted(report, supervisor.early.unreported)
        return report
    raise AssertionError  # pragma: no cover - `with` never swallows


class Supervisor:
    """Starts the processes of a launch, keeps them, and ends them.

    Attributes:
        early: has ended the run before its time; None: nothing has.
    """

    def __init__(
        self,
        deployment: Deployment,
        roster: Roster,
        orders: Orders,
        keys: Keys,
        tell: Callable[[str], None],
        resume: bool,
        record: Wanted | None = None,
    ) -> None:
        self._deployment = deployment
        self._roster = roster
        self._orders = orders
        self._keys = keys
        self._tell = tell
        self._resume = resume
        self._broken = anyio.Event()
        self._why: Exception | None = None
        self._start_s: float | None = None
        self._signals = 0
        self.early: EarlyEnd | None = None
        self._hub: Hub | None = None
        self._recorder = None if record is None else RecorderChild(record, self._say)
        self._keeping = ProcessSupervisor(orders, self._say, self._break)
        self._log = begin_log(orders.run_id, deployment.name, deployment.path, tell, lambda: self._keeping.epoch)

    async def run(self, progress: Callable[[int], None] | None) -> Report:
        """The whole launch."""
        begun = time.perf_counter()
        fault = shared_memory_fault()
        if fault:
            self._say(f"no shared memory, large messages are copied: {fault}")
        hub = Hub(self._keys, self._deployment.zenoh, progress, self._orders.host)
        self._hub = hub
        self._orders.hub = hub.endpoint
        registered = register(self._running(hub.endpoint))
        if self._orders.host:
            self._say(f"others join with --connect {hub.endpoint}")
        try:
            async with anyio.create_task_group() as tasks:
                self._keeping.tasks = tasks
                self._keeping.dismiss_elsewhere = hub.dismiss
                self._keeping.introduce = hub.introduce
                self._keeping.hears_of = hub.hears_of
                tasks.start_soon(self._watch_signals)
                try:
                    await self._start_recorder(tasks)
                    await self._start_all()
                    async with self._keeping.requests.served(hub):
                        await self._until_finished(begun)
                    if self.early is None:
                        await self._collect()
                finally:
                    with anyio.CancelScope(shield=True):
                        await self._end_all()
                        if self._recorder is not None:
                            await self._recorder.finish(self._last_epoch())
                    tasks.cancel_scope.cancel()
        finally:
            registered.unlink(missing_ok=True)
            end = "the run is over" if self._why is None else f"the run is broken off: {self._why}"
            self._log.close(f"{end}by a signal" if isinstance(self._why, _BrokenOff) else end)
            over = "the run is over" if self._why is None else "the run is broken off"
            members = self._keeping.members.items()  # nobody else tells who is kept elsewhere
            hub.dismiss_all({token: f"{name}: {over}" for name, token in members if self._keeping.child(token) is None})
            hub.close()
        if self._why is not None and not (isinstance(self._why, _BrokenOff) and self.early is not None):
            raise self._why
        return self._make_report()

    def _say(self, what: str) -> None:
        self._log.tell(what)
        self._tell(what)
        if self._hub is not None:
            self._hub.note(what)

    def _running(self, endpoint: str) -> Running:
        orders, deployment = self._orders, self._deployment
        return Running(
            orders.run_id, deployment.name, endpoint, os.getpid(), str(deployment.path.resolve()), orders.settings
        )

    async def _start_recorder(self, tasks: anyio.abc.TaskGroup) -> None:
        if self._recorder is None:
            return
        orders = self._orders
        info = orders.info(from_start=not self._resume)
        await self._recorder.start(info, orders.hub, self._deployment.zenoh, orders.host)
        orders.recorders.add(self._recorder.pid)
        tasks.start_soon(self._recorder.listen)

    def _last_epoch(self) -> int | None:
        """The last one committed, by the world's report."""
        world = self._orders.deployment.roster.world
        said = [child.report for child in self._keeping.present if child.name == world and child.report is not None]
        return int(said[0]["run"][0]) if said else None

    async def _start_all(self) -> None:
        roster = self._roster
        life = COME_BACK if self._resume else BEGIN
        if self._resume:
            self._keeping.begun.set()
        tokens = {name: token_hex(8) for name in roster.nodes}
        self._keeping.members = tokens
        for name in sorted(roster.nodes):
            others = {} if self._resume else tokens
            await self._keeping.start(self._orders.order(name, tokens[name], life, processes=others))
            if self._broken.is_set():
                return

    async def _until_finished(self, begun: float) -> None:
        """Wait for the processes to come up, then for the world to finish."""
        timeout_s = self._deployment.start_timeout_s
        async with self._unless_broken():
            late = await self._keeping.begin(timeout_s)
            if late:
                self._break(NodeFailedError(f"not up within {timeout_s:g} s (start_timeout_s): {', '.join(late)}"))
            self._start_s = time.perf_counter() - begun
            self._keeping.tasks.start_soon(self._keeping.watch_world)
            await self._keeping.finished.wait()

    async def _collect(self) -> None:
        """Have every process report and end."""
        self._keeping.finished.set()
        if self._resume and self._roster.world not in {child.name for child in self._keeping.present}:
            self._break(HieraxError(self._orders.over))  # the world had finished before
            return
        async with self._unless_broken():
            with anyio.move_on_after(REPORT_TIMEOUT_S):
                # the world last: then it has all that the others have sent, and may find that something was forged
                world = self._orders.deployment.roster.world
                await self._stop(lambda child: child.name != world)
                await self._stop(lambda child: child.name == world)
                for child in self._keeping.present:
                    await child.heard.wait()
            silent = [child.name for child in self._keeping.present if child.report is None]
            if silent:
                self._break(NodeFailedError(f"no report within {REPORT_TIMEOUT_S:g} s: {', '.join(silent)}"))

    async def _stop(self, which: Callable[[Child], bool]) -> None:
        """Have these processes report."""
        for child in self._keeping.present:
            if which(child):
                await child.tell(STOP)
        while any(which(child) and child.report is None for child in self._keeping.present):
            await anyio.sleep(POLL_S)

    async def _end_all(self) -> None:
        """End every process that is left: first kindly, then not."""
        early = self.early
        if early is not None:
            await early.collect()
        self._keeping.ending = True
        children = self._keeping.children
        for child in children:
            child.send_signal(signal.SIGTERM)
        await self._keeping.wait_for_all(END_TIMEOUT_S if early is None else CLOSE_S)
        for child in children:
            child.kill()
        await self._keeping.wait_for_all()
        if early is not None:
            early.recall()
        for child in children:
            await child.close()
        self._keeping.overhearing.close()

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

    def _break(self, why: Exception) -> None:
        if self._why is None and not self._keeping.ending:
            self._why = why
            self._broken.set()

    async def _watch_signals(self) -> None:
        """The first signal ends the run in good order, the second one at once."""
        with anyio.open_signal_receiver(*ending_signals()) as signals:
            async for _ in signals:
                self._signals += 1
                if self._signals > 1:
                    for child in self._keeping.children:
                        child.kill()
                    await self._keeping.wait_for_all()
                    remove_orphaned_segments()
                    leave_at_once()
                self._keeping.tasks.start_soon(self._end_early)

    async def _end_early(self) -> None:
        """A signal has come: the run ends with the epoch under way, or with the one before it."""
        if self._broken.is_set() or self._keeping.ending:
            return  # it comes to its end already
        if self._start_s is not None:
            self.early = EarlyEnd(self._keeping, self._deployment, self._say)
            await self.early.finish_epoch()
        self._break(_BrokenOff())

    def _make_report(self) -> Report:
        reports = {child.name: child.report for child in self._keeping.present if child.report is not None}
        world = reports.get(self._deployment.roster.world, {})
        epochs, digest, wall_s, epochs_s = world.get("run", (0, NO_DIGEST, 0.0, ()))  # it was killed before it began
        if self._deployment.staleness.barrier and self.early is None:
            _check_epochs(reports, epochs)
        nodes = {
            name: NodeReport(said["belief"], said["policy"], said["actions"], said["metrics"])
            for name, said in sorted(reports.items())
        }
        return make_report(
            self._deployment.name,
            "launch",
            self._orders.seed,
            epochs,
            digest,
            wall_s,
            epochs_s,
            nodes,
            self._orders.output,
            start_s=self._start_s,
        )


def _say_nothing(what: str) -> None:
    return


def _check_epochs(reports: Mapping[str, Mapping[str, Value]], epochs: int) -> None:
    """Every node ends with the last epoch of the run.

    Raises:
        NodeFailedError: one does not; something that it was sent is not from the world.
    """
    for name, said in sorted(reports.items()):
        if said["epoch"] != epochs:
            what = f"{name} ends in epoch {said['epoch']}, and the run in epoch {epochs}"
            raise NodeFailedError(f"{what}: somebody else has sent observations in the name of a node below it")
