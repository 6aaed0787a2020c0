"""A world for launches that tests change while they run."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from hierax.runtime import Elements, Value
from hierax.runtime.sim.nodes import Mixer, MixingWorld

PACE_S = "HIERAX_TEST_PACE_S"
"""Environment variable: how long the world waits in each epoch, so that there are not too many to repeat."""


BULK = bytes(range(256)) * 400


class Gated(MixingWorld):
    """Runs until there is a file; `hierax run`, once the file is gone, repeats it with ``--epochs``.

    Args:
        stop: path of the file; while there is one named ``pause`` beside it, `predict` does not come to its end.
    """

    def __init__(self, stop: str) -> None:
        super().__init__("world", 2)
        self._stop = Path(stop)
        self._pause = self._stop.with_name("pause")
        self._pace_s = float(os.environ.get(PACE_S, "0"))

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        if self._pace_s:
            threading.Event().wait(self._pace_s)
        while self._pause.exists():
            threading.Event().wait(0.01)
        return super().predict(context, actions, belief)

    def finished(self, belief: Value) -> bool:
        return self._stop.exists()


class Bulky(Mixer):
    """One whose belief is longer than a low-latency link carries at once."""

    def initial_belief(self) -> Value:
        return {**super().initial_belief(), "bulk": BULK}

    def _know(self, what: str, belief: Value, *parts: Value) -> Value:
        return {**super()._know(what, belief, *parts), "bulk": belief["bulk"]}
