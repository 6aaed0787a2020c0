"""One node running: its engine joined to a port, its probes and its state log.

The same in every mode: `run` steps the runners of all nodes in one thread, `launch` has
one in each process.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import msgpack

from hierax.runtime.core.binding import metrics_of
from hierax.runtime.core.errors import HieraxError, OperatorError, ProbeError
from hierax.runtime.core.probe import Probe
from hierax.runtime.engine.engine import DigestChain, Engine
from hierax.runtime.engine.outputs import Committed, Completed, Output, Refused, Send
from hierax.runtime.engine.table import Phase
from hierax.runtime.report import NodeReport
from hierax.runtime.transport.port import Port
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Message

Clock = Callable[[], float]

EPOCHS_TIMED = 1_000_000
"""Of how many epochs, the last ones, the times are kept."""

_log = logging.getLogger("hierax")


@dataclass
class NodeRunner:
    """Moves messages between a node's engine and its port.

    Sends go out first; probes and the state log are served when nobody waits for this node.

    Attributes:
        engine: of the node.
        port: of the node, open.
        probes: of the node, open.
        states: where of every completed epoch [epoch, attempt, state, digest] is written; None:
            nowhere. The state is the encoding of (belief, policy, actions) that the digest is
            taken over, so that anyone can take it again.
        pacemaker: the world's; None for other nodes.
    """

    engine: Engine
    port: Port
    probes: Sequence[Probe] = ()
    states: Log | None = None
    pacemaker: Pacemaker | None = None

    def start(self) -> None:
        """Begin the first epoch, if this is the world and there is one to run."""
        self._finish([])

    def step(self, message: Message) -> None:
        """Take a message in and do all that follows from it.

        Raises:
            OperatorError: an operator failed, or gave what cannot travel.
            ProbeError: a probe raised.
        """
        self._finish(self._send(self.engine.receive(message)))

    def close(self) -> None:
        """Close the state log and all probes.

        Raises:
            ProbeError: a probe raised.
        """
        if self.states is not None:
            self.states.close()
        with ExitStack() as closing:  # one that raises keeps none from being closed
            for probe in reversed(self.probes):
                closing.callback(self._close, probe)

    def report(self) -> NodeReport:
        """The node's state and what it reports of it.

        Raises:
            OperatorError: the node's `metrics` failed.
        """
        engine = self.engine
        state = engine.state
        completed = engine.epoch if engine.is_world else engine.epoch - 1
        metrics = metrics_of(engine.name, engine.node.node, state.belief, completed)
        return NodeReport(state.belief, state.policy, state.actions, metrics)

    def _finish(self, rest: list[Output]) -> None:
        """Do what follows; the world begins the next epoch before anything else is done."""
        pacemaker = self.pacemaker
        if pacemaker is None:
            self._record(rest)
            return
        while True:
            if any(isinstance(output, Committed) for output in rest):
                pacemaker.stop()
            begins = pacemaker.may_begin(self.engine)
            new: list[Output] = []
            if begins:
                pacemaker.start()
                new = self._send(self.engine.begin())
            self._record(rest)
            if not begins:
                return
            rest = new

    def _send(self, outputs: Iterable[Output]) -> list[Output]:
        """Send what is to be sent; give back the rest."""
        rest: list[Output] = []
        for output in outputs:
            if type(output) is Send:
                self._send_one(output.message)
            else:
                rest.append(output)
        return rest

    def _send_one(self, message: Message) -> None:
        try:
            self.port.send(message)
        except SchemaError as error:
            header = message.header
            what = f"its elements for {header.receiver} {error}"
            raise OperatorError(header.sender, header.kind, header.epoch, what) from error

    def _record(self, rest: list[Output]) -> None:
        for output in rest:
            if isinstance(output, Completed):
                if self.states is not None:
                    step = output.step
                    self.states.write(step.epoch, step.attempt, output.state, output.digest)
                for probe in self.probes:
                    self._show(probe, output)
            elif isinstance(output, Committed) and self.pacemaker is not None:
                self.pacemaker.commit(output)
            elif isinstance(output, Refused):
                header = output.header
                _log.warning(
                    "%s: refused a %s message from %s of epoch %d: %s",
                    self.engine.name,
                    header.kind,
                    header.sender,
                    header.epoch,
                    output.verdict.value,
                )

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
    _started: float = 0.0

    def may_begin(self, engine: Engine) -> bool:
        """Whether the world, when it is idle, has an epoch to begin; else the run is done."""
        if engine.phase is not Phase.IDLE or self.done:
            return False
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

    def commit(self, committed: Committed) -> None:
        """Chain the epoch's digest and tell it."""
        self.on_commit(committed.epoch, self.chain.commit(committed))

    @property
    def wall_s(self) -> float:
        """From the beginning of the first epoch to the commit of the last."""
        return 0.0 if self.first_s is None else self.last_s - self.first_s


class Log:
    """A file as a stream of msgpack arrays.

    Raises:
        HieraxError: it cannot be written, now or later.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._mapped():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = path.open("wb")

    def write(self, *fields: int | bytes) -> None:
        """Append an array."""
        try:  # not `_mapped`, as this runs in every epoch
            self._file.write(msgpack.packb(fields))
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
