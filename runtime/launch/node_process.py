"""A node in a process of its own; started by the supervisor, never by hand.

Two threads do the work. One is the node's: it loads it, opens its port, and then
receives, runs the engine and sends, with nothing else on its way. The other has the
event loop: it greets the neighbours until they answer, and listens to the supervisor.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Awaitable
from typing import Any, NoReturn

import anyio
import anyio.from_thread
import anyio.to_thread
import numpy as np

from hierax.runtime.core.binding import Setting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.engine.engine import DigestChain, Engine, Place
from hierax.runtime.files import DIGESTS, open_probes, state_log
from hierax.runtime.launch.pipe import FAILED, FINISHED, REPORT, STOP, UP, Frames, NodeOrder, frame
from hierax.runtime.loading import LoadError, bind_edge, bind_node, build_edge, build_node, extend_import_path
from hierax.runtime.runner import Log, NodeRunner, Pacemaker
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_port import EpochPublisher, ZenohPort
from hierax.runtime.transport.zenoh_session import open_session
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

GREETING_INTERVAL_S = 0.05
STUCK_S = 1.0
"""How long an operator may go on when the process is to end."""

BUG = 3
"""Exit code where a process ends with a traceback."""

_log = logging.getLogger("hierax")


class NodeProcess:
    """One node, from its order to its report."""

    def __init__(self, order: NodeOrder, status: int) -> None:
        self._order = order
        self._status = status
        self._port: ZenohPort | None = None
        self._digests: Log | None = None
        self._stopping = threading.Event()
        # then the session is not closed: what still comes from its peers would be reported as errors
        self.hurried = False

    def stop(self) -> None:
        """Make the node's thread come to its end; any thread may call it."""
        self._stopping.set()
        if self._port is not None:
            self._port.interrupt()

    def greet(self) -> bool:
        """Greet the neighbours that have not answered; whether there may be any."""
        port = self._port
        if port is None:
            return True
        if self._stopping.is_set():
            return False
        port.greet()
        return not port.rendezvous.ready

    def close(self) -> None:
        """Close the port, when no other thread uses it any more."""
        if self._port is not None:
            self._port.close()

    def say(self, status: str, **fields: Value) -> None:
        """Tell the supervisor, if it is still there."""
        data = memoryview(frame({"status": status, **fields}))
        try:
            while data:
                data = data[os.write(self._status, data) :]
        except BrokenPipeError:
            self._stopping.set()

    def live(self) -> int:
        """The node's thread: load, connect, run, report.

        Returns:
            The exit code of the process.
        """
        try:
            return self._live()
        except (HieraxError, SchemaError) as error:
            place = error.where if isinstance(error, LoadError) else ""
            message = str(error)
            if isinstance(error, (TransportError, SchemaError)):  # the others name the node themselves
                message = f"{self._order.name}: {message.removeprefix(f'{self._order.name}: ')}"
            self.say(FAILED, message=message.encode(errors="backslashreplace").decode(), where=place)
            return 1

    def _live(self) -> int:
        order = self._order
        extend_import_path(order.import_paths)
        engine = self._build_engine()
        session = open_session(connect=[order.hub], settings=order.settings)
        keys = Keys(order.deployment, order.run)
        node = engine.node
        port = ZenohPort(
            session, keys, order.name, node.below, node.above, order.roster.instances, order.roster.version
        )
        self._port = port
        epochs = EpochPublisher(session, keys) if engine.is_world else None
        runner = self._build_runner(engine, port, epochs)
        gc.collect()
        gc.freeze()  # what is loaded stays; the collector need not look at it again in the middle of an epoch
        try:
            # asked before, as `stop` interrupts only a port that is there
            if not self._stopping.is_set() and port.connect() and not self._stopping.is_set():
                self.say(UP)
                self._run(runner, port)
        finally:
            if self._digests is not None:
                self._digests.close()
            runner.close()
        self._report(runner)
        return 0

    def _build_engine(self) -> Engine:
        order, roster, name = self._order, self._order.roster, self._order.name
        setting = Setting(order.seed, _wait_in_event_loop)
        pairs = [edge.pair for edge in roster.edges]
        node = build_node(roster.nodes[name], f"nodes.{name}")
        bound = bind_node(name, node, roster.world, pairs, setting)
        sides = {edge.pair: "lower" if name == edge.lower else "upper" for edge in roster.edges if name in edge.pair}
        edges = [
            bind_edge(build_edge(edge, sides[edge.pair]), setting, sides[edge.pair])
            for edge in roster.edges
            if name in edge.pair
        ]
        return Engine(bound, edges, Place.of(roster))

    def _build_runner(self, engine: Engine, port: ZenohPort, epochs: EpochPublisher | None) -> NodeRunner:
        order = self._order
        output = order.output_path
        pacemaker = None
        if epochs is not None:
            self._digests = None if output is None else Log(output / DIGESTS)
            self._publisher = epochs
            pacemaker = Pacemaker(DigestChain(order.roster.content_hash()), order.epochs, self._on_commit)
        return NodeRunner(
            engine, port, open_probes(order.probes, order.name, output), state_log(output, order.name), pacemaker
        )

    def _on_commit(self, epoch: int, digest: bytes) -> None:
        self._publisher.publish(epoch, digest)
        if self._digests is not None:
            self._digests.write(epoch, digest)

    def _run(self, runner: NodeRunner, port: ZenohPort) -> None:
        runner.start()
        told = False
        while not self._stopping.is_set():
            if runner.pacemaker is not None and runner.pacemaker.done and not told:
                told = True
                self.say(FINISHED)
            try:
                message = port.receive()
            except SchemaError as error:
                _log.warning("%s: dropped what is no message of ours: %s", self._order.name, error)
                continue
            if message is not None:
                runner.step(message)

    def _report(self, runner: NodeRunner) -> None:
        report = runner.report()
        fields: dict[str, Value] = {
            "belief": report.belief,
            "policy": report.policy,
            "actions": report.actions,
            "metrics": dict(report.metrics),
        }
        pacemaker = runner.pacemaker
        if pacemaker is not None:
            chain = pacemaker.chain
            fields["run"] = [chain.epoch, chain.digest, pacemaker.wall_s, np.array(pacemaker.epochs_s)]
        self.say(REPORT, **fields)


def main() -> None:
    """Read the order, live, exit."""
    logging.basicConfig(level=os.environ.get("HIERAX_LOG", "WARNING").upper(), format="%(name)s: %(message)s")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's to handle
    status = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a node prints must not mix with the frames
    orders = os.dup(sys.stdin.fileno())
    with open(os.devnull, "rb") as nothing:  # nor may a node, or a program that it starts, read them
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    code = BUG
    try:
        code = anyio.run(_main, orders, status)
    except BaseException:
        traceback.print_exc()
    finally:
        _exit(code)


def _exit(code: int) -> NoReturn:
    """End the process, and the programs that its node has started and left running."""
    try:
        sys.stdout.flush()
        sys.stderr.flush()
        if os.getpgrp() == os.getpid():
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            os.killpg(0, signal.SIGTERM)
    finally:
        # Zenoh's threads may hold the interpreter up, or hang beside a stopped peer
        os._exit(code)


async def _main(orders: int, status: int) -> int:
    frames = Frames()
    commands = await _next_frames(orders, frames)
    if not commands:
        return 0
    process = NodeProcess(NodeOrder.read(commands.pop(0)), status)
    code = 0
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(_obey, process, orders, frames, commands)
        tasks.start_soon(_obey_signals, process)
        tasks.start_soon(_greet, process)
        code = await anyio.to_thread.run_sync(process.live, abandon_on_cancel=True)
        tasks.cancel_scope.cancel()
    if not process.hurried:
        process.close()
    return code


async def _obey(process: NodeProcess, orders: int, frames: Frames, commands: list[Value]) -> None:
    """Stop when the supervisor says so, at once when it is gone."""
    while True:
        if STOP in commands:
            process.stop()
        commands = await _next_frames(orders, frames)
        if not commands:
            await _end(process)


async def _obey_signals(process: NodeProcess) -> None:
    with anyio.open_signal_receiver(signal.SIGTERM) as signals:
        async for _ in signals:
            break
    await _end(process)


async def _end(process: NodeProcess) -> None:
    """Stop, and do not wait for long."""
    process.hurried = True
    process.stop()
    await anyio.sleep(STUCK_S)
    _log.warning("an operator did not come to its end; the process exits")
    _exit(1)


async def _greet(process: NodeProcess) -> None:
    while process.greet():
        await anyio.sleep(GREETING_INTERVAL_S)


async def _next_frames(orders: int, frames: Frames) -> list[Value]:
    """At least one frame from the supervisor; none when it is gone."""
    while True:
        await anyio.wait_readable(orders)
        data = os.read(orders, 1 << 16)
        if not data:
            return []
        values = frames.feed(data)
        if values:
            return values


def _wait_in_event_loop(awaitable: Awaitable[Any]) -> Any:
    async def wait() -> Any:
        return await awaitable

    return anyio.from_thread.run(wait)


if __name__ == "__main__":
    main()
