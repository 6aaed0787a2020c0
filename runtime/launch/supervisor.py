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
from typing import Any

import anyio
import anyio.abc

from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import RestartPolicy
from hierax.runtime.files import write_roster
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, NodeFailedError, Restarts, start_child
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.pipe import (
    ANSWER,
    BEAT,
    BEGIN,
    COME_BACK,
    CUT_OFF,
    DISMISSED,
    END,
    FAILED,
    FINISHED,
    HALT,
    NEWCOMER,
    NOTE,
    REPORT,
    STOP,
    UP,
    Frames,
    NodeOrder,
)
from hierax.runtime.launch.requests import Requests
from hierax.runtime.launch.run_file import Run, Running, register
from hierax.runtime.owner.outlet import DETACH
from hierax.runtime.report import NodeReport, Report, make_report
from hierax.runtime.transport.hub import Hub
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments
from hierax.schemas.control import Control, Lost, encode_control
from hierax.schemas.keys import Keys
from hierax.schemas.roster import Roster

REPORT_TIMEOUT_S = 60.0
"""How long they may take for their reports, and their probes to close, when it is over."""

POLL_S = 0.01

BEAT_S = 0.2
"""How often it says something."""

SILENCE_S = 1.0
"""How long the world's process may say nothing, beyond the epoch's deadline."""


class Interrupted(Exception):  # noqa: N818 - no error: somebody pressed Ctrl-C
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

    Raises:
        HieraxError: a node cannot be loaded, did not come up in time, or failed.
        KeyboardInterrupt: broken off by SIGINT, SIGTERM or SIGHUP; all processes are gone.
    """
    if output is not None and run is None:
        write_roster(output, deployment.roster)
    with ExitStack() as stack:
        stack.callback(remove_orphaned_segments)
        if state is None:
            state = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hierax-")))
        state.mkdir(parents=True, exist_ok=True)
        limit = deployment.epochs if epochs is None else epochs
        run_id = token_hex(4)
        orders = Orders(deployment, run_id, seed, limit, output, state, host, settings, faults)
        if run is not None:
            orders.take_up(run)
        orders.keep()
        supervisor = Supervisor(
            deployment, orders, Keys(deployment.name, run_id), tell or _say_nothing, run is not None
        )
        try:
            return anyio.run(supervisor.run, progress)
        except Interrupted as error:
            raise KeyboardInterrupt from error
    raise AssertionError  # pragma: no cover - `with` never swallows


class Supervisor:
    """Starts the processes of a launch, keeps them, and ends them."""

    def __init__(
        self,
        deployment: Deployment,
        orders: Orders,
        keys: Keys,
        tell: Callable[[str], None],
        resume: bool,
    ) -> None:
        self._deployment = deployment
        self.orders = orders
        self._keys = keys
        self._say = tell
        self._resume = resume
        self._world = deployment.roster.world
        self._children: dict[str, Child] = {}
        self._current: dict[str, Child] = {}
        self._restarts: dict[str, Restarts] = {}
        self._members: Mapping[str, str] = {}
        self._finished = anyio.Event()
        self._broken = anyio.Event()
        self._why: Exception | None = None
        self._ending = False
        self._gone: set[str] = set()
        self._last_roster: Roster | None = None
        self._heard_s = 0.0
        self._beat = anyio.Event()
        self.epoch = 0
        self.version = 0
        self.instances: Mapping[str, int] = {}
        self._tasks: anyio.abc.TaskGroup
        self._requests = Requests(self)

    # --- the course of a launch

    async def run(self, progress: Callable[[int], None] | None) -> Report:
        """The whole launch."""
        begun = time.perf_counter()
        hub = Hub(self._keys, self._deployment.zenoh, progress, self.orders.host)
        self.orders.hub = hub.endpoint
        registered = register(self._running(hub.endpoint))
        if self.orders.host:
            self._say(f"others join with --connect {hub.endpoint}")
        try:
            async with anyio.create_task_group() as tasks:
                self._tasks = tasks
                tasks.start_soon(self._watch_signals)
                try:
                    await self._start_all()
                    async with self._requests.served(hub):
                        start_s = await self._until_finished(begun)
                    await self._collect()
                finally:
                    with anyio.CancelScope(shield=True):
                        await self._end_all()
                    tasks.cancel_scope.cancel()
        finally:
            registered.unlink(missing_ok=True)
            for name, token in self._members.items():
                if token not in self._children:  # nobody else tells who is kept elsewhere
                    hub.dismiss(
                        token, f"{name}: the run is over" if self._why is None else f"{name}: the run is broken off"
                    )
            hub.close()
        if self._why is not None:
            raise self._why
        return self._make_report(start_s)

    def _running(self, endpoint: str) -> Running:
        orders, deployment = self.orders, self._deployment
        return Running(
            orders.run_id, deployment.name, endpoint, os.getpid(), str(deployment.path.resolve()), orders.settings
        )

    async def _start_all(self) -> None:
        roster = self.orders.known_roster(self._resume)
        life = COME_BACK if self._resume else BEGIN
        tokens = {name: token_hex(8) for name in roster.nodes}
        self._members = tokens
        for name in sorted(roster.nodes):
            others = {} if self._resume else tokens
            await self.start(self.orders.order(name, tokens[name], life, processes=others))
            if self._broken.is_set():
                return

    async def start(self, order: NodeOrder) -> Child:
        """Start a node's process."""
        child = await start_child(order)
        self._children[child.token] = child
        if order.life != NEWCOMER:
            self._current[child.name] = child
        self._restarts.setdefault(child.name, Restarts(self.orders.policy(child.name)))
        self._tasks.start_soon(self._listen, child)
        return child

    async def _until_finished(self, begun: float) -> float:
        """Wait for the processes to come up, then for the world to finish.

        Returns:
            Seconds from the launch until all were up.
        """
        timeout_s = self._deployment.start_timeout_s
        start_s = 0.0
        async with self._unless_broken():
            first = dict(self._current)
            with anyio.move_on_after(timeout_s):
                for child in first.values():
                    await child.up.wait()
            late = [name for name, child in first.items() if not child.up.is_set()]
            if late:
                self._break(NodeFailedError(f"not up within {timeout_s:g} s (start_timeout_s): {', '.join(late)}"))
            start_s = time.perf_counter() - begun
            self._heard_s = time.monotonic()
            self._tasks.start_soon(self._watch_world)
            await self._finished.wait()
        return start_s

    async def _collect(self) -> None:
        """Have every process report and end."""
        self._finished.set()
        async with self._unless_broken():
            with anyio.move_on_after(REPORT_TIMEOUT_S):
                for child in self._present():
                    await child.tell(STOP)
                while any(child.report is None for child in self._present()):
                    await anyio.sleep(POLL_S)
                for child in self._present():
                    await child.heard.wait()
            silent = [child.name for child in self._present() if child.report is None]
            if silent:
                self._break(NodeFailedError(f"no report within {REPORT_TIMEOUT_S:g} s: {', '.join(silent)}"))

    def _present(self) -> list[Child]:
        """The processes of the roster in force that are kept here."""
        return [child for child in self._children.values() if self._members.get(child.name) == child.token]

    async def _end_all(self) -> None:
        """End every process that is left: first kindly, then not."""
        self._ending = True
        children = list(self._children.values())
        for child in children:
            child.send_signal(signal.SIGTERM)
        await self._wait_for_all()
        for child in children:
            child.kill()
        await self._wait_for_all()
        for child in children:
            await child.close()

    async def _wait_for_all(self) -> None:
        """Bounded, as a program that a node has started may hold its pipes open when the node is gone."""
        with anyio.move_on_after(END_TIMEOUT_S):
            for child in list(self._children.values()):
                await child.process.wait()

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
                    for child in self._children.values():
                        child.kill()
                    await self._wait_for_all()
                    remove_orphaned_segments()
                    os._exit(130)
                self._break(Interrupted())

    # --- what the processes say

    async def _listen(self, child: Child) -> None:
        """Take in what a child says until its process ends."""
        assert child.process.stdout is not None
        frames = Frames()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(child.cut_off, tasks.cancel_scope)
            async for data in child.process.stdout:
                for value in frames.feed(data):
                    self._take(child, value)
            with anyio.move_on_after(END_TIMEOUT_S):
                await child.process.wait()
            tasks.cancel_scope.cancel()
        child.heard.set()
        if not self._ending and child.report is None:
            await self._on_end(child)

    def _take(self, child: Child, value: dict[str, Any]) -> None:
        status = value["status"]
        if status == UP:
            child.up.set()
        elif status == REPORT:
            child.report = value
        elif status == FAILED:
            child.failure = NodeFailedError(value["message"], value["where"])
        elif status == DISMISSED:
            child.dismissed = value["why"]
            self._say(f"{child.name}: its process exits: {child.dismissed}")
        elif status == CUT_OFF:
            child.culprit = value["why"]
        elif self._current.get(self._world) is child:
            self._take_from_world(value)

    def _take_from_world(self, value: dict[str, Any]) -> None:
        status = value["status"]
        if status == BEAT:
            self._heard_s = time.monotonic()
            self.epoch = value["epoch"]
            self.version = value["version"]
            self.instances = value["instances"]
            self._on_members(value["processes"])
            self._beat.set()
            self._beat = anyio.Event()
        elif status == FINISHED:
            self._on_members(value["processes"])
            self._last_roster = Roster.read(value["roster"])
            self._finished.set()
        elif status == NOTE:
            self._say(value["what"])
        elif status == ANSWER:
            self._requests.answer(value["request"], value["epoch"], value["refusal"])
        elif status == END:
            self._kill(value["name"], value["process"], value["why"])
        elif status == HALT:
            child = self._current.get(value["why"].partition(":")[0])
            ended = child is not None and not child.alive and not child.culprit
            self._break(child.last_words if child is not None and ended else NodeFailedError(value["why"]))

    def _on_members(self, members: Mapping[str, str]) -> None:
        self._members = members
        for name, token in members.items():
            child = self._children.get(token)
            if child is not None and child.alive:  # of one that has ended the next process may be on its way
                self._current[name] = child

    # --- processes that end

    def _kill(self, name: str, token: str, why: str) -> None:
        """A process hangs: it is killed; that it ends is noticed as always."""
        self._say(f"{name}: its process is killed: {why}")
        child = self._children.get(token)
        if child is not None:
            child.culprit = why
            child.kill()
        else:
            self._tasks.start_soon(self.tell_owner, Lost(name, token, True))

    async def _on_end(self, child: Child) -> None:
        """A process has ended before its time."""
        name = child.name
        if child.dismissed:
            return
        if self._current.get(name) is not child:
            await self.tell_owner(Lost(name, child.token, True))
            await anyio.sleep(2 * BEAT_S)  # it may have been taken in just now
            if self._current.get(name) is not child:
                self._requests.failed(child)
                return
        failure = child.last_words
        if not child.up.is_set() and not self._restarts[name].count and not child.order.request:
            self._break(failure)
            return
        delay_s = self._restarts[name].delay_s(child)
        if delay_s is None and (name == self._world or self.orders.policy(name).on_loss != DETACH):
            self._break(failure)
            return
        self._say(f"{failure}" + ("" if delay_s is None else "; it is started again"))
        if name != self._world:
            await self.tell_owner(Lost(name, child.token, delay_s is not None))
        if delay_s is not None:
            await anyio.sleep(delay_s)
            await self._restart(child)

    async def _restart(self, child: Child) -> None:
        name = child.name
        if self._ending:
            return
        token = token_hex(8)
        if self._last_roster is not None and name != self._world:  # nothing is left to do but to report
            self._members = {**self._members, name: token}
            await self.start(self.orders.to_report(child.order, token, self._last_roster))
            await self._current[name].tell(STOP)
            return
        processes = {other: member for other, member in self._members.items() if self._may_live(member)}
        order = self.orders.again(child.order, token, processes, self._requests.proposals)
        await self.start(order)
        self._heard_s = time.monotonic()

    async def _watch_world(self) -> None:
        """The world's process watches the others; here it is watched itself."""
        deadline_s = self._deployment.epoch_deadline_s
        if deadline_s is None:
            return
        while True:
            await anyio.sleep(SILENCE_S / 5)
            world = self._current[self._world]
            if world.alive and time.monotonic() - self._heard_s > max(deadline_s, SILENCE_S):
                self._heard_s = time.monotonic()
                self._kill(self._world, world.token, "it does not answer")

    # --- what others ask for

    def _may_live(self, token: str) -> bool:
        """Whether a process is alive, as far as is known here; of one kept elsewhere that is whether it is heard of."""
        child = self._children.get(token)
        return token not in self._gone if child is None else child.alive

    async def on_gone(self, name: str, token: str) -> None:
        """A process is gone, or cut off; what is kept here is noticed more surely by its end."""
        if token not in self._children and token not in self._gone and self._members.get(name) == token:
            self._gone.add(token)
            self._say(f"{name}: its process, kept elsewhere, is gone or cannot be reached")
            await self.tell_owner(Lost(name, token, True))

    async def tell_owner(self, word: Control) -> None:
        """What the world's process does not take in, because it has ended, its next one is told in its order."""
        world = self._current.get(self._world)
        if world is not None and world.alive:
            await world.tell(encode_control(word))

    async def hear_members(self) -> None:
        """Wait until the world has said anew who there is."""
        with anyio.move_on_after(SILENCE_S):
            for _ in range(2):  # the first may have been on its way
                await self._beat.wait()

    def adopt(self, request: str, policies: Mapping[str, RestartPolicy]) -> None:
        """A change is in force, with new nodes."""
        self.orders.adopt(request, policies)
        self._restarts.update({name: Restarts(policy) for name, policy in policies.items()})

    def child(self, token: str) -> Child | None:
        """A process that is kept here."""
        return self._children.get(token)

    def cut_off(self, token: str) -> bool:
        """Whether a process that is kept elsewhere cannot be reached."""
        return token in self._gone

    def restarts_of(self, name: str) -> int:
        """How often a node's process was started again."""
        return self._restarts[name].count if name in self._restarts else 0

    @property
    def members(self) -> Mapping[str, str]:
        """The processes of the roster in force, by node, as the world said last."""
        return self._members

    def _make_report(self, start_s: float) -> Report:
        reports = {child.name: child.report for child in self._present() if child.report is not None}
        epochs, digest, wall_s, epochs_s = reports[self._world]["run"]
        nodes = {
            name: NodeReport(said["belief"], said["policy"], said["actions"], said["metrics"])
            for name, said in sorted(reports.items())
        }
        return make_report(
            self._deployment.name,
            "launch",
            self.orders.seed,
            epochs,
            digest,
            wall_s,
            epochs_s,
            nodes,
            self.orders.output,
            start_s=start_s,
        )


def _say_nothing(what: str) -> None:
    return
