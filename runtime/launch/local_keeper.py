"""Keeping processes of nodes on this machine for a launch on another one."""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from secrets import token_hex

import anyio
import anyio.abc
import anyio.to_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import RestartPolicy
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, Restarts, start_child
from hierax.runtime.launch.frames import COME_BACK, Frames, NodeOrder
from hierax.runtime.launch.here import AttachedHere, read_orders
from hierax.runtime.launch.overheard import Overhearing
from hierax.runtime.transport.launch_client import LaunchClient, is_gone
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

LOOK_S = 2.0
"""How often it is looked whether the launch is still there."""

SETTLE_S = 0.5
"""After what time the launch's keeper has heard of a dismissal; and how long it may take to answer."""


def keep(
    orders: Value,
    request: str,
    here: AttachedHere,
    policies: Mapping[str, RestartPolicy],
    told: Callable[[], None],
    say: Callable[[str], None],
) -> int:
    """Start processes and keep them until they are dismissed, or until Ctrl-C.

    Args:
        orders: what they are started with, as the launch has answered.
        request: the change that was asked for, as the launch calls it.
        here: what is decided on this machine.
        policies: by node, what is done when its process ends.
        told: waits until the launch has answered, and tells it; in a thread of its own.
        say: tells people what happens.

    Returns:
        The exit code: 0 when all were dismissed or the user ended them.

    Raises:
        HieraxError: a process cannot go on, the change was refused, or the orders are not what was asked for.
    """
    try:
        # nobody else knows the folder's name before it is there
        with tempfile.TemporaryDirectory(prefix="hierax-", ignore_cleanup_errors=True) as folder:
            read = read_orders(orders, request, here, Path(folder))
            return anyio.run(_LocalKeeper(read[0].run, policies, say).run, read, told)
    finally:
        remove_orphaned_segments()


class _LocalKeeper:
    """Processes of nodes, started again when they die."""

    def __init__(self, run: str, policies: Mapping[str, RestartPolicy], say: Callable[[str], None]) -> None:
        self._restarts = {name: Restarts(policy) for name, policy in policies.items()}
        self._say = say
        self._children: list[Child] = []
        self._overhearing = Overhearing(run, lambda: 0)  # how far the run is, is not known here
        self._failure: Exception | None = None
        self._ending = False
        self._kept = 0
        self._leaving = 0

    async def run(self, orders: Sequence[NodeOrder], told: Callable[[], None]) -> int:
        """All of it."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._end_on_signal, tasks.cancel_scope)
            tasks.start_soon(self._tell, told, tasks.cancel_scope)
            tasks.start_soon(self._watch_hub, orders[0].hub, tasks.cancel_scope)
            try:
                async with anyio.create_task_group() as kept:
                    self._kept = len(orders)
                    for order in orders:
                        kept.start_soon(self._keep, order, tasks.cancel_scope)
            finally:
                with anyio.CancelScope(shield=True):
                    await self._end_all()
            tasks.cancel_scope.cancel()
        if self._failure is not None:
            raise self._failure
        return 0

    async def _tell(self, told: Callable[[], None], scope: anyio.CancelScope) -> None:
        try:
            await anyio.to_thread.run_sync(told, abandon_on_cancel=True)
        except Exception as error:
            self._fail(error, scope)

    async def _keep(self, order: NodeOrder, scope: anyio.CancelScope) -> None:
        while True:
            child = await start_child(order, self._overhearing)
            self._children.append(child)
            await self._listen(child)
            if self._ending:
                return
            if child.dismissed and not await self._has_place(order):
                self._say(f"{child.name}: its process exits: {child.dismissed}")
                self._kept -= 1
                return
            if child.dismissed:
                child.culprit = f"{child.name}: somebody has dismissed its process, and not the launch"
            delay_s = self._restarts[child.name].delay_s(child)
            if delay_s is None:
                self._fail(child.last_words, scope)
                return
            self._say(f"{child.culprit or child.last_words}; it is started again")
            await anyio.sleep(delay_s)
            order = replace(order, process=token_hex(8), life=COME_BACK, request="")

    async def _has_place(self, order: NodeOrder) -> bool:
        """Whether a process that was dismissed runs its node all the same, by what the launch's keeper says."""
        self._leaving += 1  # where it is over for all of them, a launch that is gone is no failure
        try:
            await anyio.sleep(SETTLE_S)  # until it has heard of the dismissal, if there was one
            return await anyio.to_thread.run_sync(_is_counted_on, order, abandon_on_cancel=True)
        finally:
            self._leaving -= 1

    async def _listen(self, child: Child) -> None:
        assert child.process.stdout is not None
        frames = Frames()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(child.overheard.listen)
            async for data in child.process.stdout:
                for value in frames.feed(data):
                    child.take(value)
            await child.process.wait()
            tasks.cancel_scope.cancel()

    async def _watch_hub(self, endpoint: str, scope: anyio.CancelScope) -> None:
        """A launch that cannot be reached may be reached again; one that is gone says so to whoever knocks."""
        while True:
            await anyio.sleep(LOOK_S)
            gone = await anyio.to_thread.run_sync(is_gone, endpoint, abandon_on_cancel=True)
            if gone and self._leaving < self._kept:
                self._fail(HieraxError(f"the launch at {endpoint} is gone; its nodes here are ended"), scope)

    def _fail(self, error: Exception, scope: anyio.CancelScope) -> None:
        self._failure = self._failure or error
        scope.cancel()

    async def _end_on_signal(self, scope: anyio.CancelScope) -> None:
        with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
            async for _ in signals:
                scope.cancel()
                return

    async def _end_all(self) -> None:
        self._ending = True
        for child in self._children:
            child.send_signal(signal.SIGTERM)
        with anyio.move_on_after(END_TIMEOUT_S):
            for child in self._children:
                await child.process.wait()
        for child in self._children:
            child.kill()
            await child.process.wait()
            await child.close()
        self._overhearing.close()


def _is_counted_on(order: NodeOrder) -> bool:
    if is_gone(order.hub):
        return False
    try:
        with LaunchClient(order.hub, order.settings, Keys(order.deployment, order.run)) as client:
            node = client.status(SETTLE_S).nodes.get(order.name, {})
    except HieraxError:
        return False
    return node.get("process") == order.process
