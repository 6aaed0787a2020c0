"""Processes on this machine of nodes that are attached to a launch on another one.

Whoever answers at an endpoint says what is to be started. So of an order no more is taken over than what the run is and
how its epochs go; what runs, and all that touches this machine, comes from what its user has named.
"""

import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import anyio
import anyio.abc
import anyio.to_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.host.run_secret import certificates_of, is_secret, may_issue
from hierax.runtime.launch.child import Child, Overhearing, ProcessState, start_process
from hierax.runtime.launch.fork_server import ForkServer
from hierax.runtime.launch.frames import COME_BACK, NEWCOMER, NodeOrder, new_process
from hierax.runtime.launch.process_supervisor import Fail, Notify, ProcessSupervisor
from hierax.runtime.launch.renewal import PARTS, renew
from hierax.runtime.launch.run_file import passing_state
from hierax.runtime.loading.allowance import Allowance, module_of
from hierax.runtime.transport.launch_client import LaunchClient, is_gone
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments
from hierax.runtime.watch.refused import overheard
from hierax.schemas.access import Access
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import Keys, check_name, check_process
from hierax.schemas.roster import Reference
from hierax.schemas.values import Value

SHORTEST_S = 3.0  # how long certificates hold at least, by what is believed here of what the launch says
AGAIN = 4  # how often it is asked for one in the time after which another one is due

LOOK_S = 2.0  # how often it is looked whether the launch is still there
SETTLE_S = 0.5  # after what time the launch has heard of a dismissal; and how long it may take to answer


def run_attached(
    orders: Value,  # what they are started with, as the launch has answered
    request: str,  # the change that was asked for, as the launch calls it
    here: "AttachedHere",  # what is decided on this machine
    terms: Mapping[str, ProcessTerms],  # by node, what is done when its process ends
    await_change: Callable[[], None],  # waits until the launch has answered, and prints that; in a thread of its own
    notify: Notify,  # tells people what happens
) -> int:
    """Start processes and have them run until all are dismissed, or Ctrl-C ends them; gives the exit code.

    Raises `HieraxError` if a process cannot go on, the change was refused, or the orders are not what was asked for.
    """
    try:
        # nobody else knows the folder's name before it is there
        with passing_state() as folder:
            read = read_orders(orders, request, here, folder)
            # of this machine's scheduler is asked what its user says, not what a launch does
            read = [replace(order, scheduling=terms[order.name].scheduling) for order in read]
            with overheard(notify):
                return anyio.run(_run, read, terms, partial(new_secret, here=here), await_change, notify)
    finally:
        remove_orphaned_segments()


async def _run(
    orders: Sequence[NodeOrder],
    terms: Mapping[str, ProcessTerms],
    renewed: Callable[[NodeOrder], str],
    await_change: Callable[[], None],
    notify: Notify,
) -> int:
    why: list[Exception] = []
    async with anyio.create_task_group() as tasks:

        def fail(error: Exception) -> None:
            why.append(error)
            tasks.cancel_scope.cancel()

        attached = AttachedProcesses(tasks, orders, terms, renewed, notify, fail)
        tasks.start_soon(_end_on_signal, tasks.cancel_scope)
        tasks.start_soon(_await, await_change, fail)
        try:
            await attached.run()
        finally:
            with anyio.CancelScope(shield=True):
                await attached.end_all()
                attached.close()
        tasks.cancel_scope.cancel()
    attached.overhearing.close()
    if why:
        raise why[0]
    return 0


class AttachedProcesses(ProcessSupervisor):
    """The processes of attached nodes, started again when they die, until the launch has dismissed all of them."""

    def __init__(
        self,
        tasks: anyio.abc.TaskGroup,  # in which everything runs
        orders: Sequence[NodeOrder],  # what they are started with
        terms: Mapping[str, ProcessTerms],  # by node, what is done when its process ends
        renewed: Callable[[NodeOrder], str],  # asks the launch for a new certificate of a node; takes a while
        notify: Notify,  # tells people what happens
        fail: Fail,  # called with why they cannot go on
    ) -> None:
        overhearing = Overhearing(orders[0].run, lambda: 0)  # how far the run is, is not known here
        super().__init__(tasks, overhearing, terms.__getitem__, notify, fail)
        self._forks = ForkServer().start()
        self._orders = orders
        self._renewed = renewed
        self._attached = len(orders)
        self._leaving = 0
        self._all_dismissed = anyio.Event()

    async def run(self) -> None:
        """Start all of them, and wait until all are dismissed."""
        self.tasks.start_soon(self._watch_hub, self._orders[0].hub)
        try:
            for order in self._orders:
                await self.start(order)
        except HieraxError as error:  # raised from within the tasks, it would be a group's
            self.fail(error)
            return
        if self._orders[0].lifetime_s is not None:
            self.tasks.start_soon(self._renew_again_and_again, self._orders[0].lifetime_s)
        await self._all_dismissed.wait()

    def close(self) -> None:
        super().close()
        self._forks.close()

    async def _begin(self, orders: Sequence[NodeOrder]) -> list[Child]:
        return await start_process(orders, self.overhearing, self._forks)

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
        await self.start(replace(child.order, process=new_process(child.name), life=COME_BACK, request=""))

    async def _has_place(self, order: NodeOrder) -> bool:
        """Whether a process that was dismissed runs its node all the same, by what the launch says."""
        self._leaving += 1  # where it is over for all of them, a launch that is gone is no failure
        try:
            await anyio.sleep(SETTLE_S)  # until it has heard of the dismissal, if there was one
            return await anyio.to_thread.run_sync(_is_counted_on, order, abandon_on_cancel=True)
        finally:
            self._leaving -= 1

    async def _renew_again_and_again(self, lifetime_s: float) -> None:
        """Have all go on with new certificates before theirs end; for whom there is none, it is asked again soon."""
        while True:
            await anyio.sleep(lifetime_s / PARTS)
            left = self.children
            while left := [child for child in left if child.is_up and not await self._is_renewed(child)]:
                await anyio.sleep(lifetime_s / PARTS / AGAIN)

    async def _is_renewed(self, child: Child) -> bool:
        """Whether the launch has given another certificate, with which the next process is started, too."""
        try:
            secret = await anyio.to_thread.run_sync(self._renewed, child.order, abandon_on_cancel=True)
        except HieraxError as error:
            if child.is_up:
                self.notify(f"{child.name}: there is no other certificate for its process yet: {error}")
            return False
        child.order = replace(child.order, secret=secret)
        await renew(child, secret, self.notify)
        return True

    async def _watch_hub(self, endpoint: str) -> None:
        """A launch that cannot be reached may be reached again; one that is gone says so to whoever knocks. Where it
        has ended, it has told its nodes so, which need a while to go."""
        was_gone = False
        while True:
            await anyio.sleep(LOOK_S)
            gone = await anyio.to_thread.run_sync(is_gone, endpoint, abandon_on_cancel=True)
            if gone and was_gone and not self._all_leave():
                self.fail(HieraxError(f"the launch at {endpoint} is gone; its nodes here are ended"))
            was_gone = gone

    def _all_leave(self) -> bool:
        """Whether what still runs here was dismissed, or looks whether it was."""
        dismissed = sum(1 for child in self.children if child.dismissed and child.state is not ProcessState.ENDED)
        return self._leaving + dismissed >= self._attached


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
        with LaunchClient(order.hub, order.settings, Keys(order.deployment, order.run), order.secret) as client:
            node = client.status(SETTLE_S).nodes.get(order.name, {})
    except HieraxError:
        return False
    return node.get("process") == order.process


@dataclass(frozen=True)
class AttachedHere:
    """What the user of this machine has named."""

    nodes: Mapping[str, Reference]  # which are asked for
    allowance: Allowance  # which code may be loaded
    trusts: bool  # whether what the launch allows may be loaded, too
    import_paths: Sequence[str]  # where modules are looked for
    endpoint: str  # of the launch
    host: str  # this machine's address for the others; empty: the launch is on this machine
    settings: Value  # Zenoh's own
    secret: str = field(default="", repr=False)  # of the run; empty: it is open


def read_orders(orders: Value, request: str, here: AttachedHere, folder: Path) -> list[NodeOrder]:
    """The orders for this machine, where the checkpoints are in a folder that was made for this alone.

    Raises `NotAllowedError` if a node's class may not be loaded here, and `HieraxError` if they are no orders, or not
    of the nodes that were asked for.
    """
    if not isinstance(orders, (list, tuple)) or not all(isinstance(order, dict) for order in orders):
        raise HieraxError(f"the launch at {here.endpoint} gave no orders, but {shown(orders)}")
    names = [order.get("name") for order in orders]
    if sorted(map(str, names)) != sorted(here.nodes):
        asked = ", ".join(map(repr, sorted(here.nodes)))
        raise HieraxError(f"the launch at {here.endpoint} orders processes of {shown(names)}; asked for were {asked}")
    return [_local(order, request, here, folder) for order in orders]


def _local(order: Mapping[str, Any], request: str, here: AttachedHere, folder: Path) -> NodeOrder:
    name: str = order["name"]
    reference = here.nodes[name]
    allowance = here.allowance
    if here.trusts:
        allowance = allowance.with_modules(map(str, _field(order, "modules", list, tuple)))
    allowance.check(reference.target, f"nodes.{name}.class")
    return NodeOrder(
        name=name,
        process=_name(order, "process", check_process),
        life=NEWCOMER,
        request=request,
        deployment=_name(order, "deployment"),
        run=_name(order, "run"),
        modules=allowance.modules,
        preload=(module_of(reference.target),),
        seed=_field(order, "seed", int),
        epochs=_field(order, "epochs", int, type(None)),
        staleness=_field(order, "staleness", int, type(None)),
        rate_hz=_field(order, "rate_hz", float, int, type(None)),
        budget_ms=_field(order, "budget_ms", float, int, type(None)),
        period_ms=_field(order, "period_ms", float, int, type(None)),
        rated=_field(order, "rated", bool),
        hub=here.endpoint,
        host=here.host,
        settings=here.settings,
        secret=_secret(order, here),
        access=_access(order, here),
        lifetime_s=_lifetime_s(order),
        low_latency=_field(order, "low_latency", bool),
        import_paths=tuple(here.import_paths),
        checkpoint=str(folder / name),
        durability="host" if order.get("durability") == "host" else "process",
        recorded=_field(order, "recorded", bool),
        elsewhere=True,
    )


def _field(order: Mapping[str, Any], field: str, *kinds: type) -> Any:
    value = order.get(field)
    if type(value) not in kinds:
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise HieraxError(f"{order['name']}: the launch's order says {field}: {shown(value)}; expected {expected}")
    return value


def _secret(order: Mapping[str, Any], here: AttachedHere) -> str:
    """The secret for the node's role, by which the launch lets it in; who attaches it has one for another role."""
    if not certificates_of(here.secret):
        return here.secret
    secret = _field(order, "secret", str)
    if not is_secret(secret) or may_issue(secret) or not certificates_of(secret):
        raise HieraxError(f"{order['name']}: the launch's order has no certificate for it")
    return str(secret)


def _lifetime_s(order: Mapping[str, Any]) -> float | None:
    """How long certificates of the run hold."""
    lifetime_s = _field(order, "lifetime_s", float, int, type(None))
    if lifetime_s is not None and not 0 < lifetime_s < inf:
        raise HieraxError(f"{order['name']}: the launch's order says lifetime_s: {lifetime_s}; expected a time")
    return None if lifetime_s is None else max(float(lifetime_s), SHORTEST_S)


def new_secret(order: NodeOrder, here: AttachedHere) -> str:
    """What the launch lets a node's process in with from now on. Raises `HieraxError` if it gives none."""
    keys = Keys(order.deployment, order.run)
    with LaunchClient(here.endpoint, here.settings, keys, here.secret) as client:
        answer = client.ask({"ask": "renew", "name": order.name, "process": order.process, "host": here.host})
    return _secret({"name": order.name, **answer}, here)


def _access(order: Mapping[str, Any], here: AttachedHere) -> Access | None:
    """Who has roles of their own in the run."""
    if not certificates_of(here.secret):
        return None
    try:
        return Access.read(order.get("access"))
    except SchemaError as error:
        raise HieraxError(f"{order['name']}: the launch's order says access: {error}") from error


def _name(order: Mapping[str, Any], field: str, check: Callable[[str, str], str] = check_name) -> str:
    try:
        return check(order.get(field), field)  # type: ignore[arg-type]
    except SchemaError as error:
        raise HieraxError(f"{order['name']}: the launch's order says {field}: {error}") from error
