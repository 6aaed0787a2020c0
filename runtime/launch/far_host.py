"""A host beside the launch's own, and the processes of nodes there, as the launch sees them."""

import signal
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import anyio
import anyio.abc
import anyio.to_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import Host
from hierax.runtime.execution.output_folder import Log, digest_log, state_log
from hierax.runtime.execution.pacemaker import SteadyClock
from hierax.runtime.host.private_files import errors_named
from hierax.runtime.host.zenoh_settings import names_file
from hierax.runtime.launch.child import Child, Overheard, Overhearing
from hierax.runtime.launch.frames import APPEND, BEGIN, DIGESTS, KEEP, KEPT, LOG, REPORT, STATES, NodeOrder, frame
from hierax.runtime.launch.keeper import BEAT_S
from hierax.runtime.launch.keeper_link import Greeting, KeeperLink
from hierax.runtime.launch.pipes import read_some, write_whole
from hierax.runtime.recovery.disk import SLOTS, MappedFile
from hierax.runtime.recovery.slots import without_padding
from hierax.runtime.transport.node_answers import is_report
from hierax.runtime.watch.logs import ForwardedLog
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.messages import TYPE_NAMES
from hierax.schemas.values import Value

SILENT_S = 2.0  # for how long nothing is heard of a host until people are told so
LOOK_S = 0.2
REDIAL_S = 1.0  # how long it takes until a host that is lost is called again

_KILLED = -signal.SIGKILL
_SHARE = 0.7  # of `Host.lost_after_s`, after which a keeper gives the launch up: it has ended its processes by then

_KEEPERS: Mapping[str, type] = {
    **dict.fromkeys(("printed", "line", "refused", "started", "from", "ended"), str),
    **dict.fromkeys(("pid", "code"), int),
    "data": bytes,
}
"""The fields of what a keeper says."""

_PROCESSES: Mapping[str, type] = {
    **dict.fromkeys(("message", "where", "why", "what", "line", "name", "process", "request", "refusal"), str),
    **dict.fromkeys(("number", "slot", "epoch", "attempt", "version"), int),
    **dict.fromkeys(("final", "again"), bool),
    **dict.fromkeys(("processes", "instances", "roster"), dict),
    "data": bytes,
}
"""Those of what a process says of itself, as far as they are of one type."""

Notify = Callable[[str], None]


class FarHost:
    """One host: what it is told, what its keeper says, and whether it is there. `link`: to its keeper, which has said
    this first."""

    def __init__(self, host: Host, link: KeeperLink, greeting: Greeting) -> None:
        self.host = host
        self.greeting = greeting
        self._link: KeeperLink | None = link
        self._called: KeeperLink | None = None
        self.there = anyio.Event()  # set while it is there; another one comes when it is lost
        self._processes: dict[str, list[FarChild]] = {}
        self._outgoing, self._queue = anyio.create_memory_object_stream[bytes](inf)
        self._clock = SteadyClock()
        self._heard_s = self._clock()

    @property
    def is_there(self) -> bool:
        return self.there.is_set()

    @property
    def is_silent(self) -> bool:
        return self._clock() - self._heard_s > SILENT_S

    def say(self, value: Value) -> None:
        with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError):  # it is lost, and its processes with it
            self._outgoing.send_nowait(frame(value))

    def start(self, orders: Sequence[NodeOrder]) -> list[Child]:
        """Start the process of some orders. Raises `HieraxError` if a checkpoint of theirs, or a file with Zenoh's
        settings, cannot be read here."""
        process = FarProcess(orders[0].process, self.say)
        children = [FarChild(order, process, self) for order in orders]
        for child in children if len(children) > 1 else ():
            child.mates = list(children)
        if self.is_there:
            self._processes[process.token] = children
            self.say({"start": [child.far_order(self.host, self.greeting).plain() for child in children]})
        for child in () if self.is_there else children:
            child.lose(f"with host {self.host.name}, which is not there")
        return list(children)

    async def keep(self, overhearing: Overhearing, notify: Notify) -> None:
        """Listen to the keeper; when it is lost, call it again and again."""
        while True:
            if self._link is not None:
                why = await self._listen(self._link, overhearing)
                self._lose(why, notify)
            await anyio.sleep(REDIAL_S)
            if await self._is_called():
                notify(f"host {self.host.name} is there again")

    async def _is_called(self) -> bool:
        """Start its keeper; whether there is one now."""
        link: KeeperLink | None = None
        try:
            self._called = link = KeeperLink(self.host)
            self.greeting = await anyio.to_thread.run_sync(link.greeting, abandon_on_cancel=True)
        except HieraxError:  # it may be there the next time
            if link is not None:
                link.close(0.0)
            return False
        self._link = link
        self._outgoing, self._queue = anyio.create_memory_object_stream[bytes](inf)
        return True

    async def _listen(self, link: KeeperLink, overhearing: Overhearing) -> str:
        """Until the host is lost; gives why."""
        self._heard_s = self._clock()
        self.there.set()
        why: list[str] = []
        async with anyio.create_task_group() as tasks:

            async def until_lost(task: Callable[[], Any]) -> None:
                why.append(await task())
                tasks.cancel_scope.cancel()

            tasks.start_soon(until_lost, partial(self._read, link, overhearing))
            tasks.start_soon(until_lost, partial(self._write, link, self._queue))
            tasks.start_soon(until_lost, self._watch)
            tasks.start_soon(_show, link, overhearing)
        return why[0]

    def _lose(self, why: str, notify: Notify) -> None:
        self.there = anyio.Event()
        self._outgoing.close()
        if self._link is not None:
            self._link.close(0.0)
        self._link = None
        notify(f"host {self.host.name} is lost: {why}")
        for children in list(self._processes.values()):
            for child in children:
                child.lose(f"with host {self.host.name}")
        self._processes.clear()

    async def _read(self, link: KeeperLink, overhearing: Overhearing) -> str:
        while True:
            try:
                data = await read_some(link.words)
            except OSError as error:
                return str(error)
            if not data:
                return f"ssh has ended{link.last_line}"
            try:
                for value in link.frames.feed(data):
                    self._heard_s = self._clock()
                    self._take(value, overhearing)
            except (SchemaError, KeyError) as error:
                return f"its keeper says what cannot be read: {error}"

    def _take(self, value: Value, overhearing: Overhearing) -> None:
        _check(value, _KEEPERS, "keeper")
        if "printed" in value:
            overhearing.note(value["printed"], value["line"])
        if "refused" in value:
            overhearing.refused(value["refused"])
        for kind in ("started", "from", "ended"):
            children = self._processes.get(value.get(kind, ""))
            if children:
                children[0].far_process.hear(value)
                if kind == "ended":
                    del self._processes[value[kind]]

    async def _write(self, link: KeeperLink, queue: Any) -> str:
        self.say({"lost_after_s": _SHARE * self.host.lost_after_s})
        async for data in queue:
            try:
                await write_whole(link.orders, data)
            except OSError:
                return f"ssh has ended{link.last_line}"
        return "it is told nothing more"

    async def _watch(self) -> str:
        """Say that the launch lives, until nothing was heard of the host for too long."""
        said_s = 0.0
        while True:
            await anyio.sleep(LOOK_S)
            now = self._clock()
            if now - said_s >= BEAT_S:
                said_s = now
                self.say({})
            if now - self._heard_s > self.host.lost_after_s:
                return f"nothing was heard of it for {self.host.lost_after_s:g} s (lost_after)"

    def close(self) -> None:
        """Have the keeper end its processes, and itself; not for long."""
        if self._link is not None:
            self._link.close()
        if self._called is not None and self._called is not self._link:
            self._called.close(0.0)


async def _show(link: KeeperLink, overhearing: Overhearing) -> None:
    """What processes there print, and `ssh`."""
    lines = overhearing.passed_on()
    with suppress(OSError):
        while data := await read_some(link.errors):
            link.heard(data)
            lines.write(data)


class FarChild(Child):
    """A process of a node on another host. Its checkpoint is here, where others of that node find it."""

    def __init__(self, order: NodeOrder, process: "FarProcess", far: FarHost) -> None:
        super().__init__(order, process, _Unheard(), host=far.host.name)
        self.far_process = process
        self._far = far
        self._storage: MappedFile | None = MappedFile(Path(order.checkpoint), order.durability)
        self._log = ForwardedLog(order.run, order.name)
        self._output: dict[str, Log | None] = {}

    @property
    def is_silent(self) -> bool:
        return self.alive and self._far.is_silent

    @property
    def is_far(self) -> bool:
        return True

    def far_order(self, host: Host, greeting: Greeting) -> NodeOrder:
        """The order as the process there gets it."""
        assert self._storage is not None
        order = self.order
        there = replace(
            order,
            host=host.address or greeting.own_address,
            import_paths=(".",) if host.folder else (),
            settings=_in_full(order.settings),
            output="",
            states=bool(order.output),
            checkpoint="",
            slots=tuple(without_padding(self._storage.read(slot)) for slot in range(SLOTS)),
        )
        return there.admitted()

    def renewed_secret(self) -> str:
        return self.far_order(self._far.host, self._far.greeting).secret

    def take(self, value: Mapping[str, Any]) -> bool:
        status = value["status"]
        _check(value, _PROCESSES, "pipe")
        if status == REPORT and not is_report(value):
            raise SchemaError(f"expected a report, got {shown(value)}", "pipe")
        if status == KEEP:
            self._keep(value["number"], value["slot"], value["data"])
        elif status == LOG:
            self._log.write(value["line"])
        elif status == APPEND:
            self._append(value["kind"], value["fields"])
        else:
            return super().take(value)
        return True

    def _keep(self, number: int, slot: int, data: bytes) -> None:
        if self._storage is not None:
            self._storage.write(slot, data)
            self._storage.flush()
            self.far_process.say(frame((self.token, {KEPT: number})))

    def _append(self, kind: str, fields: Sequence[Any]) -> None:
        may = (STATES, DIGESTS) if self.order.owner is not None else (STATES,)  # the world alone tells digests
        if kind not in may or not all(type(field) in (int, bytes) for field in fields):
            raise SchemaError(f"expected numbers and bytes for {' or '.join(may)}, got {shown(kind)}", "pipe")
        if kind not in self._output:
            output, again = self.order.output_path, self.order.life != BEGIN
            self._output[kind] = state_log(output, self.name, again) if kind == STATES else digest_log(output, again)
        log = self._output[kind]
        if log is not None:
            log.write(*fields)
            log.flush()

    def lose(self, how: str) -> None:
        """Take the process for lost, whatever it does: nothing that it says counts any more."""
        self.gone = how
        self.far_process.end(_KILLED)

    def kill(self) -> None:
        if self.code is None and self.alive:
            self.send_signal(signal.SIGKILL)
            self.far_process.end(_KILLED)  # it may be out of reach, and is done with all the same

    def _kill_group(self) -> None:
        """Its keeper does that: here, its number is that of another process, or of none."""

    def release(self) -> None:
        if self._storage is not None:
            self._storage.close()
            self._storage = None
        for log in filter(None, self._output.values()):
            log.close()
        self._output.clear()
        self._log.close()

    def close(self) -> None:
        self.release()


class FarProcess:
    """What stands for a process on another host, which its keeper calls by a token. `tell`: tells the keeper."""

    def __init__(self, token: str, tell: Callable[[Value], None]) -> None:
        self.token = token
        self.pid = 0  # its number there; 0: it is not known yet
        self.returncode: int | None = None
        self._tell = tell
        self._ended = anyio.Event()
        self._said, self._words = anyio.create_memory_object_stream[bytes](inf)

    def hear(self, value: Mapping[str, Any]) -> None:
        """What the keeper says of it."""
        if "started" in value:
            self.pid = value["pid"]
        elif "ended" in value:
            self.end(value["code"])
        elif self.returncode is None:
            self._said.send_nowait(value["data"])

    def end(self, code: int) -> None:
        """It has ended, or is taken for that."""
        if self.returncode is None:
            self.returncode = code
            self._said.close()
            self._ended.set()

    async def wait(self) -> int:
        await self._ended.wait()
        assert self.returncode is not None
        return self.returncode

    async def send(self, data: bytes) -> None:
        if self.returncode is not None:
            raise BrokenPipeError
        self.say(data)

    def say(self, data: bytes) -> None:
        """Have it read something."""
        self._tell({"to": self.token, "data": data})

    def send_signal(self, number: int) -> None:
        self._tell({"signal": self.token, "number": int(number)})

    async def said(self) -> AsyncIterator[bytes]:
        async for data in self._words:
            yield data

    def close(self) -> None:
        self._words.close()


class _Unheard(Overheard):
    """What a process prints on another host comes by its keeper."""

    def __init__(self) -> None:
        return

    async def listen(self) -> None:
        return

    def close(self) -> None:
        return


def _check(value: Value, fields: Mapping[str, type], where: str) -> None:
    """Raises `SchemaError` if a host says something else than a map with fields of these types."""
    if type(value) is not dict:
        raise SchemaError(f"expected a map, got {shown(value)}", where)
    for name, each in value.items():
        if type(each) is not fields.get(name, type(each)):
            raise SchemaError(f"expected {TYPE_NAMES[fields[name]]}, got {shown(each)}", f"{where}.{name}")


def _in_full(settings: Value) -> Value:
    """Zenoh's settings, without a file of this machine. Raises `HieraxError` if that cannot be read any more."""
    if names_file(settings):
        with errors_named(settings, "read"):
            return Path(settings).read_text(encoding="utf-8", errors="replace")
    return settings
