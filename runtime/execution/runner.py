"""One node running: its engine joined to a port, its probes and its state log.

The same in every mode: `run` steps the runners of all nodes in one thread, `launch` has
one in each process.
"""

from __future__ import annotations

import logging
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import msgpack

from hierax.runtime.core.binding import metrics_of
from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.errors import HieraxError, OperatorError, ProbeError
from hierax.runtime.core.probe import Probe
from hierax.runtime.core.staleness import BARRIER, Staleness
from hierax.runtime.core.travel import elements_cannot_travel
from hierax.runtime.engine.effects import Called, Committed, Completed, EngineEffects, Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.stale import StaleEngine
from hierax.runtime.engine.table import Phase, Verdict
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.report import NodeReport
from hierax.runtime.host.private_files import open_result
from hierax.runtime.transport.port import Port
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.messages import Header, Message

Clock = Callable[[], float]

EPOCHS_TIMED = 1_000_000
"""Of how many epochs, the last ones, the times are kept."""

_log = logging.getLogger("hierax")


class NodeRunner(EngineEffects):
    """Moves messages between a node's engine and its port.

    What must lack no epoch, wherever the process dies, is written before the checkpoint and what is sent: the state
    log, and what prompt probes see. Other probes and watchers are served when nobody waits for this node.

    Args:
        wiring: of the node; None: `wire` gives it later.
        port: of the node, open.
        probes: of the node, open.
        states: where of every completed epoch [epoch, attempt, state, digest] is written; None:
            nowhere. The state is the encoding of (belief, policy, actions) that the digest is
            taken over, so that anyone can take it again.
        pacemaker: the world's; None for other nodes.

    Attributes:
        engine: of the node.
        staleness: of the deployment; to be set before `wire`.
        watchers: who sees what the node does.
        last: the last epoch that it has completed; None: none yet.
    """

    staleness: Staleness = BARRIER
    watchers: tuple[Watcher, ...] = ()
    last: Completed | None = None

    def __init__(
        self,
        wiring: Wiring | None,
        port: Port,
        probes: Sequence[Probe] = (),
        states: Log | None = None,
        pacemaker: Pacemaker | None = None,
    ) -> None:
        self.port = port
        self.probes = probes
        self.states = states
        self.pacemaker = pacemaker
        self._completed: list[Completed] = []
        self._committed: Committed | None = None
        if wiring is not None:
            self.wire(wiring)

    def wire(self, wiring: Wiring, saved: Saved | None = None, joins: bool = False) -> None:
        """Make the engine; its arguments are those of `Engine`."""
        if self.staleness.barrier:
            self.engine = Engine(wiring, self, saved=saved, joins=joins)
        else:
            self.engine = StaleEngine(wiring, self, saved=saved, joins=joins, staleness=self.staleness)
        if self.watchers:  # one that comes at this moment, in another thread, finds the engine
            self.engine.events = True

    def watch(self, watcher: Watcher) -> None:
        """Have a watcher see what the node does from now on; always called by the same thread."""
        self._set_watchers((*self.watchers, watcher))

    def unwatch(self, watcher: Watcher) -> None:
        """Have it see nothing more; by the thread that calls `watch`."""
        self._set_watchers(tuple(each for each in self.watchers if each is not watcher))

    def _set_watchers(self, watchers: tuple[Watcher, ...]) -> None:
        self.watchers = watchers  # replaced, never changed in place: the node's thread may be going through them
        if hasattr(self, "engine"):
            self.engine.events = bool(watchers)

    def start(self) -> None:
        """Begin the first epoch, if this is the world and there is one to run."""
        self._finish()

    def step(self, message: Message) -> None:
        """Take a message in and do all that follows from it.

        Raises:
            OperatorError: an operator failed, or gave what cannot travel.
            ProbeError: a probe raised.
        """
        for watcher in self.watchers:
            watcher.received(message)
        try:
            self.engine.receive(message)
        except OperatorError as error:
            self.failed(error)
        self._finish()

    def poll(self) -> bool:
        """In free running: take part in the next epoch, if there is one; whether there was.

        Raises:
            OperatorError: an operator failed, or gave what cannot travel.
            ProbeError: a probe raised.
        """
        engine = self.engine
        for watcher in self.watchers:
            watcher.turned()
        if self.pacemaker is None:
            did = self._poll(engine)
        else:
            before = engine.epoch
            if self.pacemaker.may_begin(engine):
                self._begin_next(self.pacemaker)
            did = engine.epoch != before
        self._finish()
        return did

    def _poll(self, engine: Engine) -> bool:
        try:
            return isinstance(engine, StaleEngine) and engine.poll()
        except OperatorError as error:
            self.failed(error)
            return True

    def failed(self, error: OperatorError) -> None:
        """An operator or edge function that ran here has raised, or given what it must not.

        Raises:
            OperatorError: the same, unless somebody sees to it that the epoch is done again without its node.
        """
        raise error

    def close(self) -> None:
        """Close the state log, all watchers and all probes.

        Raises:
            ProbeError: a probe raised.
        """
        if self.states is not None:
            self.states.close()
        for watcher in self.watchers:
            watcher.close()
        with ExitStack() as closing:  # one that raises keeps none from being closed
            for probe in reversed(self.probes):
                closing.callback(self._close, probe)

    def report(self, committed: int | None = None) -> NodeReport:
        """The node's state and what it reports of it.

        Args:
            committed: the last epoch that is, where the one after it may be under way; None: none is.

        Raises:
            OperatorError: the node's `metrics` failed.
        """
        engine = self.engine
        ahead = committed is not None and self.staleness.barrier and engine.epoch > committed
        state = engine.start if ahead else engine.state
        metrics = metrics_of(engine.name, engine.node.node, state.belief, engine.epoch - ahead)
        if isinstance(engine, StaleEngine):
            metrics.update(engine.ages.metrics())
        return NodeReport(state.belief, state.policy, state.actions, metrics)

    def send(self, message: Message) -> None:
        for watcher in self.watchers:
            message = watcher.sending(message)
        try:
            self.port.send(message)
        except SchemaError as error:
            kind, sender, receiver, epoch = message.header[:4]
            raise elements_cannot_travel(kind, sender, receiver, epoch, error) from error
        for watcher in self.watchers:
            watcher.sent(message)

    def called(self, called: Called) -> None:
        for watcher in self.watchers:
            watcher.called(called)

    def rewired(self, version: int) -> None:
        for watcher in self.watchers:
            watcher.rewired(version)

    def predicted(self, completed: Completed) -> None:
        if self.states is not None:
            step = completed.step
            self.states.write(step.epoch, step.attempt, completed.state, completed.digest)
            self.states.flush()
        for probe in self.probes:
            if probe.prompt:
                self._show(probe, completed)

    def completed(self, completed: Completed) -> None:
        self._completed.append(completed)

    def act(self, epoch: int, actions: Elements) -> None:
        act = self.engine.node.act
        if act is not None:
            act(epoch, self.engine.time_s, actions)
        for watcher in self.watchers:
            watcher.acted(epoch)

    def committed(self, committed: Committed) -> None:
        self._committed = committed
        if self.pacemaker is not None:
            self.pacemaker.stop()

    def refused(self, header: Header, verdict: Verdict) -> None:
        _log.log(
            self._gravity(header, verdict),
            "%s: refused a %s message from %s of epoch %d: %s",
            self.engine.name,
            header.kind,
            header.sender,
            header.epoch,
            verdict.value,
        )
        for watcher in self.watchers:
            watcher.refused(header, verdict)

    def _gravity(self, header: Header, verdict: Verdict) -> int:
        """At which level a refusal is logged."""
        return logging.WARNING

    def _finish(self) -> None:
        """Do what follows; the world begins the next epoch before anything else is done."""
        while self._completed or self._may_begin():
            committed, self._committed = self._committed, None
            completed, self._completed = self._completed, []
            pacemaker = self.pacemaker
            if pacemaker is not None:
                if committed is not None:
                    pacemaker.chain.commit(committed.epoch, committed.digest)
                digest = pacemaker.chain.digest
                self._go_on(committed)
                if committed is not None:
                    pacemaker.on_commit(committed.epoch, digest)
                    for watcher in self.watchers:
                        watcher.committed(committed.epoch, digest)
            self._serve(completed)
        for watcher in self.watchers:
            watcher.served()

    def _may_begin(self) -> bool:
        return not self.staleness.free and self.pacemaker is not None and self.pacemaker.may_begin(self.engine)

    def _go_on(self, committed: Committed | None) -> None:
        """An epoch may be begun."""
        if self.pacemaker is not None and self._may_begin():
            self._begin_next(self.pacemaker)

    def _begin_next(self, pacemaker: Pacemaker) -> None:
        self.drain(pacemaker.limit == self.engine.epoch + 1)
        pacemaker.start()
        self.engine.begin()

    def drain(self, drains: bool) -> None:
        """Whether the world's next epoch is a drained one; the last one is, so that every node has a part in it."""
        if isinstance(self.engine, StaleEngine):
            self.engine.drains = drains

    def _serve(self, completed: Iterable[Completed]) -> None:
        for each in completed:
            self.last = each
            for watcher in self.watchers:
                watcher.completed(each)
            for probe in self.probes:
                if not probe.prompt:
                    self._show(probe, each)

    def _close(self, probe: Probe) -> None:
        try:
            probe.close()
        except Exception as error:
            raise ProbeError(self.engine.name, probe, "close", error) from error

    def _show(self, probe: Probe, completed: Completed) -> None:
        try:
            probe.record(completed.step)
        except Exception as error:
            raise ProbeError(self.engine.name, probe, f"record in epoch {completed.step.epoch}", error) from error


@dataclass
class Pacemaker:
    """The world's side of a run: how many epochs, how long they took, and their digests.

    Attributes:
        chain: of the digests.
        limit: how many epochs; None: until the world has finished.
        asked: whether the run is to end as soon as may be; any thread, and a signal's handler, may set it.
        on_commit: told each epoch and its digest, after the next one has begun.
        clock: seconds.
        epochs_s: how long each epoch took, from its beginning to its commit; of the last `EPOCHS_TIMED`.
    """

    chain: DigestChain
    limit: int | None
    on_commit: Callable[[int, bytes], None]
    clock: Clock = time.perf_counter
    epochs_s: deque[float] = field(default_factory=lambda: deque(maxlen=EPOCHS_TIMED))
    first_s: float | None = None
    last_s: float = 0.0
    done: bool = False
    asked: bool = False
    _started: float = 0.0

    def may_begin(self, engine: Engine) -> bool:
        """Whether the world, when it is idle, has an epoch to begin; else the run is done."""
        if engine.phase is not Phase.DONE or self.done:
            return False
        if self.asked:
            soonest = engine.epoch + isinstance(engine, StaleEngine)  # where epochs overlap, the last one is drained
            self.limit = soonest if self.limit is None else min(self.limit, soonest)
            self.asked = False
        self.done = (self.limit is not None and engine.epoch >= self.limit) or engine.finished
        return not self.done

    def start(self) -> None:
        """An epoch begins."""
        self._started = self.clock()
        if self.first_s is None:
            self.first_s = self._started

    def stop(self) -> None:
        """An epoch is committed."""
        self.last_s = self.clock()
        self.epochs_s.append(self.last_s - self._started)

    @property
    def wall_s(self) -> float:
        """From the beginning of the first epoch to the commit of the last."""
        return 0.0 if self.first_s is None else self.last_s - self.first_s


class Log:
    """A file as a stream of msgpack arrays.

    Args:
        path: of the file.
        append: go on behind what is there, but for an entry that was cut off; this is looked at when
            something is written, as until then another process may still be writing.

    Raises:
        HieraxError: it cannot be written, now or later.
    """

    def __init__(self, path: Path, append: bool = False) -> None:
        self._path = path
        with self._mapped():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = os.fdopen(open_result(path, append), "ab" if append else "wb")
            if not append:
                self._file.truncate(0)
        self._behind = append

    def write(self, *fields: int | bytes) -> None:
        """Append an array."""
        try:  # not `_mapped`, as this runs in every epoch
            if self._behind:
                self._behind = False
                os.truncate(self._path, _whole_bytes(self._path))
            self._file.write(msgpack.packb(fields))
        except OSError as error:
            raise self._error(error) from error

    def flush(self) -> None:
        """Give what is buffered to the system: then it outlives the process."""
        try:
            self._file.flush()
        except OSError as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Write out what is buffered."""
        with self._mapped():
            self._file.close()

    @contextmanager
    def _mapped(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._error(error) from error

    def _error(self, error: OSError) -> HieraxError:
        return HieraxError(f"{self._path}: cannot be written: {error.strerror or error}")


def _whole_bytes(path: Path) -> int:
    """Up to where a stream of msgpack arrays holds whole ones."""
    with path.open("rb") as file:
        unpacker = msgpack.Unpacker(file, max_buffer_size=MAX_MESSAGE_BYTES)
        whole = 0
        try:
            while True:
                unpacker.skip()
                whole = unpacker.tell()
        except (msgpack.OutOfData, ValueError):
            return whole
