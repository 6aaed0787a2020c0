"""Processes on this machine of nodes that are attached to a launch on another one."""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from secrets import token_hex
from typing import Any

import anyio
import anyio.abc
import anyio.to_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import RestartPolicy
from hierax.runtime.launch.child import Child
from hierax.runtime.launch.frames import COME_BACK, NodeOrder
from hierax.runtime.launch.here import AttachedHere, read_orders
from hierax.runtime.launch.overheard import Overhearing
from hierax.runtime.launch.process_supervisor import Fail, Notify, ProcessSupervisor
from hierax.runtime.transport.launch_client import LaunchClient, is_gone
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

LOOK_S = 2.0  # how often it is looked whether the launch is still there
SETTLE_S = 0.5  # after what time the launch has heard of a dismissal; and how long it may take to answer


def run_attached(
    orders: Value,  # what they are started with, as the launch has answered
    request: str,  # the change that was asked for, as the launch calls it
    here: AttachedHere,  # what is decided on this machine
    policies: Mapping[str, RestartPolicy],  # by node, what is done when its process ends
    await_change: Callable[[], None],  # waits until the launch has answered, and prints that; in a thread of its own
    notify: Notify,  # tells people what happens
) -> int:
    """Start processes and have them run until all are dismissed, or Ctrl-C ends them; gives the exit code.

    Raises `HieraxError` if a process cannot go on, the change was refused, or the orders are not what was asked for.
    """
    try:
        # nobody else knows the folder's name before it is there
        with tempfile.TemporaryDirectory(prefix="hierax-", ignore_cleanup_errors=True) as folder:
            return anyio.run(_run, read_orders(orders, request, here, Path(folder)), policies, await_change, notify)
    finally:
        remove_orphaned_segments()


async def _run(
    orders: Sequence[NodeOrder], policies: Mapping[str, RestartPolicy], await_change: Callable[[], None], notify: Notify
) -> int:
    why: list[Exception] = []
    async with anyio.create_task_group() as tasks:

        def fail(error: Exception) -> None:
            why.append(error)
            tasks.cancel_scope.cancel()

        attached = AttachedProcesses(tasks, orders, policies, notify, fail)
        tasks.start_soon(_end_on_signal, tasks.cancel_scope)
        tasks.start_soon(_await, await_change, fail)
        try:
            await attached.run()
        finally:
            with anyio.CancelScope(shield=True):
                await attached.end_all()
                await attached.close()
        tasks.cancel_scope.cancel()
    attached.close_output()
    if why:
        raise why[0]
    return 0


class AttachedProcesses(ProcessSupervisor):
    """The processes of attached nodes, started again when they die, until the launch has dismissed all of them."""

    def __init__(
        self,
        tasks: anyio.abc.TaskGroup,  # in which everything runs
        orders: Sequence[NodeOrder],  # what they are started with
        policies: Mapping[str, RestartPolicy],  # by node, what is done when its process ends
        notify: Notify,  # tells people what happens
        fail: Fail,  # called with why they cannot go on
    ) -> None:
        overhearing = Overhearing(orders[0].run, lambda: 0)  # how far the run is, is not known here
        super().__init__(tasks, overhearing, policies.__getitem__, notify, fail)
        self._orders = orders
        self._attached = len(orders)
        self._leaving = 0
        self._all_dismissed = anyio.Event()

    async def run(self) -> None:
        """Start all of them, and wait until all are dismissed."""
        self.tasks.start_soon(self._watch_hub, self._orders[0].hub)
        for order in self._orders:
            await self.start(order)
        await self._all_dismissed.wait()

    def _take(self, child: Child, value: dict[str, Any]) -> None:
        return  # what only the supervisor of a launch can do something about

    async def _on_end(self, child: Child) -> None:
        if child.dismissed and not await self._has_place(child.order):
            self.notify(f"{child.name}: its process exits: {child.dismissed}")
            self._attached -= 1
            if not self._attached:
                self._all_dismissed.set()
            return
        if child.dismissed:
            child.culprit = f"{child.name}: somebody has dismissed its process, and not the launch"
        delay_s = self._restarts[child.name].delay_s(child)
        if delay_s is None:
            self.fail(child.last_words)
            return
        self.notify(f"{child.culprit or child.last_words}; it is started again")
        await anyio.sleep(delay_s)
        await self.start(replace(child.order, process=token_hex(8), life=COME_BACK, request=""))

    async def _has_place(self, order: NodeOrder) -> bool:
        """Whether a process that was dismissed runs its node all the same, by what the launch says."""
        self._leaving += 1  # where it is over for all of them, a launch that is gone is no failure
        try:
            await anyio.sleep(SETTLE_S)  # until it has heard of the dismissal, if there was one
            return await anyio.to_thread.run_sync(_is_counted_on, order, abandon_on_cancel=True)
        finally:
            self._leaving -= 1

    async def _watch_hub(self, endpoint: str) -> None:
        """A launch that cannot be reached may be reached again; one that is gone says so to whoever knocks."""
        while True:
            await anyio.sleep(LOOK_S)
            gone = await anyio.to_thread.run_sync(is_gone, endpoint, abandon_on_cancel=True)
            if gone and self._leaving < self._attached:
                self.fail(HieraxError(f"the launch at {endpoint} is gone; its nodes here are ended"))


async def _await(await_change: Callable[[], None], fail: Fail) -> None:
    try:
        await anyio.to_thread.run_sync(await_change, abandon_on_cancel=True)
    except Exception as error:
        fail(error)


async def _end_on_signal(scope: anyio.CancelScope) -> None:
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async for _ in signals:
            scope.cancel()
            return


def _is_counted_on(order: NodeOrder) -> bool:
    if is_gone(order.hub):
        return False
    try:
        with LaunchClient(order.hub, order.settings, Keys(order.deployment, order.run)) as client:
            node = client.status(SETTLE_S).nodes.get(order.name, {})
    except HieraxError:
        return False
    return node.get("process") == order.process
