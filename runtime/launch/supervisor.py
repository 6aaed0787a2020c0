"""Launching a deployment: each node its own process, or as it says, kept alive until the run is over."""

import os
import shutil
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from secrets import token_hex
from typing import NoReturn

import anyio
import anyio.lowlevel

from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.execution.output_folder import write_roster
from hierax.runtime.execution.pacemaker import ending_signals, leave_at_once
from hierax.runtime.execution.report import Interrupted, NodeReport, Report
from hierax.runtime.execution.timing import timing_of
from hierax.runtime.host.run_secret import certificates_of, new_secret
from hierax.runtime.launch.audit import Audit, proof_of
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, NodeFailedError
from hierax.runtime.launch.fork_server import ForkServer
from hierax.runtime.launch.frames import BEGIN, COME_BACK, new_process
from hierax.runtime.launch.graceful_end import CLOSE_S, GracefulEnd
from hierax.runtime.launch.hosts import Hosts, Reached, reached
from hierax.runtime.launch.orders import LaunchOptions, Orders, OverError, access_of, together
from hierax.runtime.launch.process_supervisor import Notify
from hierax.runtime.launch.recorder_process import RecorderChild, RecordingRequest
from hierax.runtime.launch.renewal import Shown, one_of_each, renew_again_and_again
from hierax.runtime.launch.requests import Requests
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.runtime.launch.run_file import (
    Run,
    Running,
    forget,
    held_state,
    key_path,
    known_here,
    passing_state,
    warning_of,
)
from hierax.runtime.transport.access_control import access_control
from hierax.runtime.transport.hub import Hub
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments, shared_memory_fault
from hierax.runtime.watch.logs import begin_log
from hierax.runtime.watch.refused import overheard
from hierax.schemas.keys import Keys
from hierax.schemas.roster import Roster
from hierax.schemas.values import Value

REPORT_TIMEOUT_S = 60.0  # how long they may take for their reports, and their probes to close, when it is over

POLL_S = 0.01
LOOK_S = 0.05  # at who wants the run to end


class _Interruption(Exception):  # noqa: N818 - no error: somebody pressed Ctrl-C
    """A signal has come."""


def launch(
    deployment: Deployment,  # what to run
    *,
    epochs: int | None,  # how many; None: the deployment's number, or until the world has finished
    seed: int,  # of all random numbers
    output: Path | None = None,  # folder for the states, digests and what probes write; None: nothing is written
    progress: Callable[[int, bytes], None] | None = None,  # told epochs committed and their digests; holds nothing up
    notify: Notify = lambda what: None,  # told what happens to the processes
    state: Path | None = None,  # folder of the checkpoints, which stays; None: one that goes with the run
    resumed: Run | None = None,  # go on with this run, whose checkpoints are in `state`
    host: str | None = None,  # as `LaunchOptions` has it
    overrides: Sequence[str] = (),  # likewise
    overwrite: bool = False,  # whether the run that is in `state` gives way to this one
    recording: RecordingRequest | None = None,  # whether and where it is recorded; told how that ended
    opened: Callable[[str, str], None] = lambda endpoint, secret: None,  # told when all are up: where, and its secret
    broken: threading.Event | None = None,  # set by who wants it to end, as a signal does; needed outside main threads
    forks: ForkServer | None = None,  # has the processes forked, where it was started already; is closed at the end
) -> Report:
    """Run a deployment with each node in a process of its own, over Zenoh.

    Raises `HieraxError` if a node cannot be loaded, did not come up in time, or failed; `Interrupted` if SIGINT,
    SIGTERM or SIGHUP broke it off, all processes gone; before all nodes were up `KeyboardInterrupt`.
    """
    begun_s = time.perf_counter()
    with (forks or ForkServer()).start() as forks, ExitStack() as stack:
        stack.callback(remove_orphaned_segments)
        found = stack.enter_context(reached(deployment))
        if found.links and host is None:
            host = found.address(deployment.hosts.values())
        passing = state is None
        if state is None:
            state = stack.enter_context(passing_state())
        stack.enter_context(held_state(state, resumed is not None, overwrite))
        if output is not None and resumed is None:
            write_roster(output, deployment.roster)
        limit = deployment.epochs if epochs is None else epochs
        options = LaunchOptions(seed, limit, state, output, host, overrides, passing)
        run_id = token_hex(4)
        secret = "" if deployment.open else new_secret(authority=bool(host) and not deployment.insecure)
        keys = Keys(deployment.name, run_id)
        access = access_control(keys, access_of(deployment)) if certificates_of(secret) else None
        hub = Hub(keys, deployment.zenoh, progress, host, secret, access)
        stack.callback(hub.close)
        orders = Orders(deployment, run_id, hub.endpoint, options, resumed, secret)
        hub.watch_recorders(orders.recorders.hear_of)
        roster = orders.roster()
        orders.save()
        up = partial(opened, hub.endpoint, secret)
        try:
            return anyio.run(_run, orders, roster, hub, found, forks, notify, recording, begun_s, broken, up)
        except _Interruption as error:
            raise KeyboardInterrupt from error
        except Exception as error:
            only = _only(error)
            if only is error or not isinstance(only, HieraxError):
                raise
            raise only from None
    raise AssertionError  # pragma: no cover - `with` never swallows


def _only(error: BaseException) -> BaseException:
    """What has failed, where it is one thing: the tasks that run beside others make a group of it."""
    held: Sequence[BaseException] = getattr(error, "exceptions", ())
    return _only(held[0]) if len(held) == 1 else error


async def _run(
    orders: Orders,
    roster: Roster,
    hub: Hub,
    found: Reached,
    forks: ForkServer,
    notify: Notify,
    recording: RecordingRequest | None,
    begun_s: float,
    broken: threading.Event | None,
    up: Callable[[], None],
) -> Report:
    deployment = orders.deployment
    path = str(deployment.path.resolve())
    pid, is_open = os.getpid(), deployment.open
    running = Running(orders.run_id, deployment.name, hub.endpoint, pid, path, orders.overrides, is_open)
    hosts = Hosts(deployment, found, forks)
    supervisor = Supervisor(orders, roster, hub, hosts, notify, recording, broken, up)
    try:
        with known_here(running, orders.secret):
            await supervisor.run(begun_s)
    finally:
        supervisor.close()
        hosts.close()
    return supervisor.report()


def _late(names: Sequence[str], timeout_s: float) -> NodeFailedError:
    """Why a run ends whose processes take too long to come up."""
    return NodeFailedError(f"not up within {timeout_s:g} s (start_timeout_s): {', '.join(names)}")


class Supervisor:
    """Starts the processes of a launch, has them run, and ends them."""

    def __init__(
        self,
        orders: Orders,
        roster: Roster,
        hub: Hub,
        hosts: Hosts,
        notify: Notify,
        recording: RecordingRequest | None,
        broken_by: threading.Event | None,
        up: Callable[[], None],
    ) -> None:
        deployment = orders.deployment
        self._deployment = deployment
        self._world = deployment.roster.world
        self._roster = roster  # with which the run begins, or goes on
        self._orders = orders  # what the processes are started with
        self._hub = hub  # through which the processes find one another
        self._print = notify  # tells people what happens
        self._broken_by = broken_by  # in the place of signals
        self._up = up  # told when all nodes are up
        self._broken = anyio.Event()
        self._why: Exception | None = None
        self._start_s: float | None = None
        self._signals = 0
        self._graceful: GracefulEnd | None = None
        self._recorder = None if recording is None else RecorderChild(recording, orders.recorder_secret, self._notify)
        self._tasks = anyio.create_task_group()
        self._hosts = hosts  # where processes are started
        self._processes = RosterSupervisor(self._tasks, orders, hub, hosts, self._notify, self._break)
        self._log = begin_log(orders.run_id, deployment.name, deployment.path, notify, lambda: self._processes.epoch)
        self._audit = Audit(orders.run_id, lambda: self._processes.epoch, proof_of(orders.secret))

    async def run(self, begun_s: float) -> None:
        """Do all of the launch. `begun_s`: when it began, by `time.perf_counter`."""
        fault = shared_memory_fault()
        if fault:
            self._notify(f"no shared memory, large messages are copied: {fault}")
        endpoint = self._hub.endpoint
        warning = warning_of(endpoint, self._hub.secret)
        if warning:
            self._notify(warning)
        self._audit.begun(str(self._deployment.path.resolve()), endpoint, warning)
        if self._orders.options.host:
            key = f" --key {key_path(self._orders.run_id)}" if self._hub.secret else ""
            self._notify(f"others join with --connect {endpoint}{key}")
        with overheard(self._audit.refused_something, self._orders.access.called()):
            await self._watched(begun_s)

    async def _watched(self, begun_s: float) -> None:
        async with self._tasks:
            self._tasks.start_soon(self._watch_signals)
            self._hosts.serve(self._tasks, self._processes.overhearing, self._notify)
            try:
                async with Requests(self._processes, self._audit).served(self._hub):
                    await self._start_recorder()
                    if not self._broken.is_set():
                        await self._start_all()
                    await self._until_finished(begun_s)
                if self._graceful is None:
                    await self._collect()
            finally:
                with anyio.CancelScope(shield=True):
                    await self._end_all()
                    if self._recorder is not None:
                        world = self._reports.get(self._world)
                        await self._recorder.finish(None if world is None else int(world["run"][0]))
                self._tasks.cancel_scope.cancel()

    def close(self) -> None:
        """Say that it is over: in the log, and to processes that were started elsewhere, as nobody else does."""
        over = "the run is over" if self._why is None else "the run is broken off"
        how = "" if self._why is None else " by a signal" if self._is_interrupted else f": {self._why}"
        self._audit.close(f"{over}{how}")
        self._log.close(f"{over}{how}")  # last: who follows logs reads until then
        members = self._processes.members.items()
        reasons = {token: f"{name}: {over}" for name, token in members if self._processes.child(token) is None}
        self._hub.dismiss_all(reasons)
        self._processes.overhearing.close()

    def report(self) -> Report:
        """What the run has come to. Raises why it could not go on; `Interrupted` if a signal has ended it."""
        if self._why is not None and not (self._is_interrupted and self._graceful is not None):
            raise self._why
        report = self._make_report()
        if self._graceful is not None:
            raise Interrupted(report, self._graceful.unreported)
        return report

    @property
    def _is_interrupted(self) -> bool:
        return isinstance(self._why, _Interruption)

    def _notify(self, what: str) -> None:
        self._log.write(what)
        self._print(what)
        self._hub.note(what)

    async def _start_recorder(self) -> None:
        """Nodes' processes are started when it listens: they wait for it, too, but not for as long as it may take to
        come up on a busy machine. Where it cannot listen the run goes on without."""
        if self._recorder is None:
            return
        orders = self._orders
        info = orders.info(from_start=not orders.resumes)
        secret, access = orders.recorder_secret(), orders.access.plain()
        await self._recorder.start(info, orders.hub, self._deployment.zenoh, secret, access)
        self._tasks.start_soon(self._recorder.listen)
        timeout_s = self._deployment.start_timeout_s
        async with self._unless_broken():
            with anyio.move_on_after(timeout_s) as patience:
                await self._recorder.settle()
            if patience.cancelled_caught:
                self._break(_late([self._recorder.name], timeout_s))
        if self._recorder.is_up:
            orders.recorders.expect()

    def _shown(self) -> list[Shown]:
        """The processes that show certificates, beside this one."""
        recorders = [self._recorder] if self._recorder is not None and self._recorder.is_up else []
        return [*recorders, *one_of_each(self._processes)]

    @property
    def _reports(self) -> dict[str, dict[str, Value]]:
        return {child.name: child.report for child in self._processes.present if child.report is not None}

    async def _start_all(self) -> None:
        roster = self._roster
        life = COME_BACK if self._orders.resumes else BEGIN
        if self._orders.resumes:
            self._processes.begun.set()
        tokens = {name: new_process(name) for name in roster.nodes}
        self._processes.members = tokens
        others = {} if self._orders.resumes else tokens
        for process, names in together(self._deployment, roster.nodes).items():
            shares = process if len(names) > 1 else ""
            make = partial(self._orders.order, life=life, processes=others, shares=shares)
            try:
                await self._processes.start_together([make(name, tokens[name]) for name in names])
            except HieraxError as error:  # raised from within the tasks, it would be a group's
                self._break(error)
            if self._broken.is_set():
                return
        await self._processes.tell_left()
        self._processes.started.set()

    async def _until_finished(self, begun_s: float) -> None:
        """Wait for the processes to come up, then for the world to finish."""
        timeout_s = self._deployment.start_timeout_s
        async with self._unless_broken():
            await anyio.lowlevel.checkpoint()  # where not all were started, it is broken, and ends here
            late = await self._processes.begin(timeout_s)
            if late:
                self._break(_late(late, timeout_s))
            else:
                self._up()
            self._start_s = time.perf_counter() - begun_s
            self._tasks.start_soon(self._processes.watch_world)
            self._tasks.start_soon(renew_again_and_again, self._shown, self._deployment.certificates_s, self._notify)
            await self._processes.finished.wait()

    async def _collect(self) -> None:
        self._processes.finished.set()
        if self._orders.resumes and self._roster.world not in {child.name for child in self._processes.present}:
            self._break(OverError(self._orders.over))  # the world had finished before
            return
        async with self._unless_broken():
            with anyio.move_on_after(REPORT_TIMEOUT_S):
                # the world last: then it has all that the others have sent, and may find that something was forged
                await self._stop(lambda child: child.name != self._world)
                await self._stop(lambda child: child.name == self._world)
                for child in self._processes.present:
                    await child.ended.wait()
            silent = [child.name for child in self._processes.present if child.report is None]
            if silent:
                self._break(NodeFailedError(f"no report within {REPORT_TIMEOUT_S:g} s: {', '.join(silent)}"))

    async def _stop(self, which: Callable[[Child], bool]) -> None:
        told: set[str] = set()
        while silent := [child for child in self._processes.present if which(child) and child.report is None]:
            for child in silent:  # some may have been started in the place of others that were killed meanwhile
                if child.token not in told:
                    told.add(child.token)
                    await self._processes.stop(child)
            await anyio.sleep(POLL_S)

    async def _end_all(self) -> None:
        """End every process that is left: first kindly, then not."""
        graceful = self._graceful
        if graceful is not None:
            await graceful.collect()
        # what nodes have said last is still on its way to a recorder
        await self._processes.end_all(CLOSE_S if graceful is not None and self._recorder is None else END_TIMEOUT_S)
        if graceful is not None:
            graceful.recall()
        self._processes.close()

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
        if self._why is None and not self._processes.ending:
            self._why = why
            self._broken.set()

    async def _watch_signals(self) -> None:
        """The first signal ends the run in good order, the second one at once."""
        if self._broken_by is not None:
            while not self._broken_by.is_set():
                await anyio.sleep(LOOK_S)
            self._tasks.start_soon(self._end_early)
            return
        with anyio.open_signal_receiver(*ending_signals()) as signals:
            async for _ in signals:
                self._signals += 1
                if self._signals > 1:
                    await self._processes.kill_all()
                    self._leave_at_once()
                self._tasks.start_soon(self._end_early)

    def _leave_at_once(self) -> NoReturn:
        """End this process from within all blocks, with nothing left behind that they would have removed."""
        remove_orphaned_segments()
        forget(self._orders.run_id)
        if self._orders.options.passing:
            shutil.rmtree(self._orders.options.state, ignore_errors=True)
        leave_at_once()

    async def _end_early(self) -> None:
        """A signal has come: the run ends with the epoch under way, or with the one before it."""
        if self._broken.is_set() or self._processes.ending:
            return  # it comes to its end already
        if self._processes.started.is_set() and await self._processes.is_under_way():
            self._graceful = GracefulEnd(self._processes, self._deployment, self._notify)
            await self._graceful.finish_epoch()
        self._break(_Interruption())

    def _make_report(self) -> Report:
        reports = self._reports
        world = reports.get(self._world, {})
        epochs, digest, *times = world.get("run", (0, NO_DIGEST, 0.0, ()))  # it was killed before it began
        if self._deployment.staleness.barrier and self._graceful is None:
            _check_epochs(reports, epochs, world.get("attempt", 0))
        fields = ("belief", "policy", "actions", "metrics")
        nodes = {name: NodeReport(*(said[field] for field in fields)) for name, said in sorted(reports.items())}
        options = self._orders.options
        run = (self._deployment.name, "launch", options.seed, epochs, digest.hex(), times[0], times[1])
        timing = timing_of({name: said.get("timing", {}) for name, said in reports.items()})
        return Report(*run, nodes, options.output, self._start_s, timing=timing)


def _check_epochs(reports: Mapping[str, Mapping[str, Value]], epochs: int, attempt: int) -> None:
    """Raises `NodeFailedError` if a node does not end with the run's last epoch, in the attempt that counts."""
    for name, said in sorted(reports.items()):
        if (said["epoch"], said["attempt"]) != (epochs, attempt):
            ends = f"{name} ends with attempt {said['attempt']} of epoch {said['epoch']}"
            what = f"{ends}, and the run with attempt {attempt} of epoch {epochs}"
            raise NodeFailedError(f"{what}: somebody else has sent observations in the name of a node below it")
