"""Nodes that take long, or fail, for tests of launches."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World


class Clock(World):
    """A world that counts epochs."""

    def initial_belief(self) -> Value:
        return 0

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + 1


class Stuck(Node):
    """Hangs in `observe` of one epoch until its process is killed."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch

    def initial_belief(self) -> Value:
        return None

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        if tick.epoch == self._epoch:
            print("stuck", flush=True)
            threading.Event().wait()
        return belief


class Failing(Node):
    """Raises in `predict` of one epoch."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch

    def initial_belief(self) -> Value:
        return None

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        if tick.epoch == self._epoch:
            raise RuntimeError("out of luck")
        return belief


class Starting(Node):
    """Starts a program in its first epoch, prints its process id, and leaves it running."""

    def initial_belief(self) -> Value:
        return None

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        if tick.epoch == 1:
            program = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            print(program.pid, file=sys.stderr, flush=True)
        return belief


class Forking(Node):
    """Forks in its first epoch; the fork, which has all its descriptors, goes on for long.

    Args:
        dies: the node's process is killed then.
    """

    def __init__(self, dies: bool) -> None:
        self._dies = dies

    def initial_belief(self) -> Value:
        return None

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        if tick.epoch == 1 and os.fork() == 0:
            threading.Event().wait()
        if self._dies:
            os.kill(os.getpid(), signal.SIGKILL)
        return belief


class Reading(Node):
    """Reads its standard input."""

    def initial_belief(self) -> Value:
        return None

    def observe(self, observations: Elements, belief: Value) -> Value:
        return sys.stdin.read()


class Waiting(Node):
    """Waits for the outside in an operator that is an ``async def``."""

    def initial_belief(self) -> Value:
        return 0

    async def observe(self, observations: Elements, belief: Value) -> Value:  # type: ignore[override]
        import anyio

        await anyio.sleep(0)
        return belief + observations[0]


def number(belief: Value) -> Elements:
    return (belief,)
