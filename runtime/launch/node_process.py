"""A process of a node, or of several that share it; forked for a supervisor (`forking`), never started by hand.

Each node has a thread (`hierax.runtime.launch.node_worker`): it receives, runs the engine and
sends, with nothing else on its way. Another one has the event loop: it greets neighbours until
they answer, and listens to the supervisor. A node that has come to its end leaves the others; one
that cannot go on ends the process.
"""

import io
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Awaitable
from contextvars import copy_context
from dataclasses import replace
from typing import Any, NoReturn

import anyio
import anyio.from_thread
import anyio.to_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import name_process, own_input, own_output
from hierax.runtime.launch.frames import (
    FINISH,
    KEPT,
    LEAVE,
    RENEW,
    RENEWED,
    ROSTER,
    STOP,
    Frames,
    NodeOrder,
    next_frames,
)
from hierax.runtime.launch.hang_watch import watch_for_hangs
from hierax.runtime.launch.kept_elsewhere import ToldRecords
from hierax.runtime.launch.node_worker import NodeWorker
from hierax.runtime.launch.process_home import ProcessHome
from hierax.runtime.watch.logs import NODE, QUIET, log_console, log_nodes, report_left_out
from hierax.runtime.watch.prints import Console, console_stream, name_prints
from hierax.schemas.control import Census, decode_control
from hierax.schemas.values import Value

TICK_S = 0.05
MOVE_S = 30.0  # how long a node may take until it uses another session, an operator that it is in among it
STUCK_S = 1.0  # how long an operator may go on when the process is to end
BUG = 3  # exit code where a process ends with a traceback

_log = logging.getLogger("hierax")


def main(descriptor: int) -> NoReturn:
    """Read the order, live, exit. `descriptor`: of the console."""
    console = Console(descriptor)
    plain = sys.stderr = console_stream(console)
    log_console()
    status = own_output()  # what a node prints must not mix with the frames
    # nor may a character that cannot be printed end it
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), sys.stdout.encoding, "backslashreplace")
    orders = own_input()  # nor may a node, or a program that it starts, read them
    code = BUG
    try:
        code = anyio.run(_main, orders, status, console)
    except BaseException:
        traceback.print_exc(file=plain)
        _log.critical("this is a bug, in hierax or in a node", exc_info=True, extra=QUIET)
    finally:
        _exit(code)


def _exit(code: int) -> NoReturn:
    """End the process, and the programs that its node has started and left running."""
    try:
        report_left_out()
        sys.stdout.flush()
        sys.stderr.flush()
        if os.getpgrp() == os.getpid():
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            os.killpg(0, signal.SIGTERM)
    finally:
        # Zenoh's threads may hold the interpreter up, or hang beside a stopped peer
        os._exit(code)


async def _main(orders: int, status: int, console: Console) -> int:
    frames = Frames()
    commands = await next_frames(orders, frames)
    if not commands:
        return 0
    nodes = [NodeOrder.read(each) for each in commands.pop(0)]
    home = ProcessHome(len(nodes))
    workers = {order.process: NodeWorker(order, status, _wait_in_event_loop, home) for order in nodes}
    name = nodes[0].shares or nodes[0].name
    name_process(name)
    whens = {order.name: workers[order.process].when for order in nodes}
    told = {order.name: log for order in nodes if (log := workers[order.process].log) is not None}
    if told and name not in told:  # what is none of the nodes' goes by way of the first one
        told[name] = ToldRecords(workers[nodes[0].process].pipe)
    log_nodes(nodes[0].run, name, whens, told)
    name_prints(name, console, whens)
    for order in nodes:
        copy_context().run(_say_hello, order)
    process = _Process(workers, home)
    watch_for_hangs(name, lambda: not all(worker.active for worker in list(workers.values())))
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(process.obey, orders, frames, commands)
        tasks.start_soon(process.obey_signals)
        tasks.start_soon(process.tick)
        code = await process.run()
        tasks.cancel_scope.cancel()
    process.close()
    return code


def _say_hello(order: NodeOrder) -> None:
    NODE.set(order.name)
    _log.info("process %d of %s: %s", os.getpid(), order.name, order.life)


class _Process:
    """The workers of a process, by their tokens; those that have come to their end are not among them any more."""

    def __init__(self, workers: dict[str, NodeWorker], home: ProcessHome) -> None:
        self._workers = workers
        self._home = home
        self._hurried = False
        self._threads = anyio.CapacityLimiter(len(workers))

    async def run(self) -> int:
        """Have all do their work; gives the exit code, which is that of the first one that cannot go on."""
        codes: list[int] = []
        async with anyio.create_task_group() as tasks:

            async def work(token: str, worker: NodeWorker) -> None:
                code = await anyio.to_thread.run_sync(worker.run, abandon_on_cancel=True, limiter=self._threads)
                if code or len(self._workers) == 1:
                    codes.append(code)
                    tasks.cancel_scope.cancel()
                    return
                del self._workers[token]
                await anyio.to_thread.run_sync(worker.part, code, limiter=self._threads)

            for token, worker in list(self._workers.items()):
                tasks.start_soon(work, token, worker)
                tasks.start_soon(_take_turns, worker)
        return codes[0]

    def close(self) -> None:
        """Give up what they hold, if there is time for it."""
        if self._hurried:
            return
        for worker in self._workers.values():
            worker.close()
        self._home.close()

    async def obey(self, orders: int, frames: Frames, commands: list[Value]) -> None:
        """Do what the supervisor says; stop when it is gone."""
        while True:
            for token, command in commands:
                worker = self._workers.get(token)
                if worker is not None and isinstance(command, dict) and RENEW in command:
                    threading.Thread(target=self._renew, args=(worker, command[RENEW]), daemon=True).start()
                elif worker is not None:
                    _obey(worker, command)
            commands = await next_frames(orders, frames)
            if not commands:
                await self._end()

    def _renew(self, told: NodeWorker, secret: str) -> None:
        """Have all nodes go on in another session, which shows another certificate."""

        def move(session: Any) -> bool:
            moved = [worker.move(session, MOVE_S) for worker in list(self._workers.values())]
            return all(moved)

        try:
            if self._home.renew(replace(told.order, secret=secret), move):
                _log.info("%s: its process shows another certificate from now on", told.order.name)
                told.pipe.say(RENEWED)
        except HieraxError as error:
            _log.warning("%s: its certificate is not renewed: %s", told.order.name, error)

    async def obey_signals(self) -> None:
        with anyio.open_signal_receiver(signal.SIGTERM) as signals:
            async for _ in signals:
                break
        await self._end()

    async def tick(self) -> None:
        while True:
            for worker in list(self._workers.values()):
                worker.greet()
                worker.tick()
            await anyio.sleep(TICK_S)

    async def _end(self) -> None:
        """Stop, and do not wait for long."""
        self._hurried = True
        for worker in self._workers.values():
            worker.hurried = True
            worker.stop()
        await anyio.sleep(STUCK_S)
        for worker in self._workers.values():
            busy = worker.busy()
            if busy:
                _log.warning("%s did not come to its end; the process exits", busy)
        _exit(1)


def _obey(worker: NodeWorker, command: Value) -> None:
    if command == FINISH:
        worker.finish()
    elif isinstance(command, dict) and KEPT in command:
        worker.kept(command[KEPT])
    elif isinstance(command, dict) and STOP in command:
        worker.stop(command[STOP], command.get(ROSTER))
    elif isinstance(command, dict):
        worker.leave(command[LEAVE])
    else:
        word = decode_control(command)
        if isinstance(word, Census):
            worker.begin(word.processes)
        else:
            worker.post(word)


async def _take_turns(worker: NodeWorker) -> None:
    period_s = worker.period_s
    if period_s is None:
        return
    due_s = anyio.current_time()
    while True:
        due_s = max(due_s + period_s, anyio.current_time())
        await anyio.sleep_until(due_s)
        worker.take_turn()


def _wait_in_event_loop(awaitable: Awaitable[Any]) -> Any:
    async def wait() -> Any:
        return await awaitable

    return anyio.from_thread.run(wait)
