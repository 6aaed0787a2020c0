"""One node running: its engine joined to a port, its probes and its state log.

The same in every mode: `run` steps the runners of all nodes in one thread, `launch` has
one in each process.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import msgpack

from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.probe import Probe
from hierax.runtime.engine.engine import DigestChain, Engine
from hierax.runtime.engine.outputs import Committed, Completed, Output, Refused, Send
from hierax.runtime.engine.table import Phase
from hierax.runtime.report import NodeReport
from hierax.runtime.transport.port import Port
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Message

Clock = Callable[[], float]

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
        self._record(self._go_on([]))

    def step(self, message: Message) -> None:
        """Take a message in and do all that follows from it.

        Raises:
            OperatorError: an operator failed, or gave what cannot travel.
        """
        self._record(self._go_on(self._send(self.engine.receive(message))))

    def close(self) -> None:
        """Close the probes and the state log."""
        for probe in self.probes:
            probe.close()
        if self.states is not None:
            self.states.close()

    def report(self) -> NodeReport:
        """The node's state and what it reports of it."""
        state = self.engine.state
        metrics = self.engine.node.node.metrics(state.belief)
        return NodeReport(
            state.belief, state.policy, state.actions, {name: float(value) for name, value in metrics.items()}
        )

    def _go_on(self, rest: list[Output]) -> list[Output]:
        """The world begins the next epoch before anything else is done."""
        pacemaker = self.pacemaker
        if pacemaker is None:
            return rest
        new = rest
        while True:
            if any(isinstance(output, Committed) for output in new):
                pacemaker.stop()
            if not pacemaker.may_begin(self.engine):
                return rest
            pacemaker.start()
            new = self._send(self.engine.begin())
            rest += new

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
                    probe.record(output.step)
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


@dataclass
class Pacemaker:
    """The world's side of a run: how many epochs, how long they took, and their digests.

    Attributes:
        chain: of the digests.
        limit: how many epochs; None: until the world has finished.
        on_commit: told each epoch and its digest, after the next one has begun.
        clock: seconds.
        epochs_s: how long each epoch took, from its beginning to its commit.
    """

    chain: DigestChain
    limit: int | None
    on_commit: Callable[[int, bytes], None]
    clock: Clock = time.perf_counter
    epochs_s: list[float] = field(default_factory=list)
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
    """A file as a stream of msgpack arrays."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = path.open("wb")

    def write(self, *fields: int | bytes) -> None:
        """Append an array."""
        self._file.write(msgpack.packb(fields))

    def close(self) -> None:
        """Write out what is buffered."""
        self._file.close()
