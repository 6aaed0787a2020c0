"""Nodes and edge functions of simulations that raise from an epoch on."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

from hierax.runtime import NO_TICK, Elements, Tick, Value
from hierax.runtime.sim.nodes import Mix, Mixer


class Failing(Mixer):
    """As `Mixer`, and one operator raises.

    Args:
        name: as `Mixer` has it.
        operator: that raises: initial_belief, observe or predict; or observe after some epochs of its own, count.
        epoch: from which on; how many.
    """

    def __init__(self, name: str, operator: str = "observe", epoch: int = 1, generation: int = 0) -> None:
        super().__init__(name, generation=generation)
        self._operator = operator
        self._epoch = epoch

    def initial_belief(self) -> Value:
        self._raise("initial_belief", self._epoch)
        return super().initial_belief()

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        self._raise("observe", tick.epoch)
        self._raise("count", belief["epochs"])
        return super().observe(observations, belief)

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        self._raise("predict", tick.epoch)
        return super().predict(context, actions, belief)

    def _raise(self, operator: str, epoch: int) -> None:
        if operator == self._operator and epoch >= self._epoch:
            raise RuntimeError("out of luck")


class Killing(Failing):
    """Kills a process before it raises.

    Args:
        name: as `Mixer` has it.
        pid: of the process.
    """

    def __init__(self, name: str, pid: int) -> None:
        super().__init__(name)
        self._pid = pid

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        os.kill(self._pid, signal.SIGKILL)
        return super().observe(observations, belief, tick)


class Waiting(Mixer):
    """Waits in its first observation until there is a file, beside one that says that it waits.

    Args:
        name: as `Mixer` has it.
        until: path of the file; what is in it is what is raised, if anything is.
    """

    def __init__(self, name: str, until: str) -> None:
        super().__init__(name)
        self._until = Path(until)

    def observe(self, observations: Elements, belief: Value) -> Value:
        self._until.with_suffix(".waits").touch()
        while not self._until.exists():
            threading.Event().wait(0.01)
        if raised := self._until.read_text(encoding="utf-8"):
            raise RuntimeError(raised)
        return super().observe(observations, belief)


class FailingMix(Mix):
    """As `Mix`, until an epoch.

    Args:
        name: as `Mix` has it.
        epoch: the first one in which it raises.
    """

    def __init__(self, name: str, epoch: int = 1) -> None:
        super().__init__(name)
        self._epoch = epoch

    def __call__(self, argument: Value, tick: Tick = NO_TICK) -> Elements:
        if tick.epoch >= self._epoch:
            raise RuntimeError("out of luck")
        return super().__call__(argument)


class SetMix(Mix):
    """Gives what cannot travel."""

    def __call__(self, argument: Value) -> Elements:
        return ({1, 2},)
