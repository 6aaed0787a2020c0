"""A world for launches that tests change while they run."""

from __future__ import annotations

import threading
from pathlib import Path

from hierax.runtime import Elements, Value
from hierax.runtime.sim.nodes import MixingWorld


class Gated(MixingWorld):
    """Runs until there is a file; `hierax run`, once the file is gone, repeats it with ``--epochs``.

    Args:
        stop: path of the file.
        pace_s: how long it waits in each epoch, so that there are not too many of them.
    """

    def __init__(self, stop: str, pace_s: float = 0.001) -> None:
        super().__init__("world", 2)
        self._stop = Path(stop)
        self._pace_s = pace_s

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        threading.Event().wait(self._pace_s)
        return super().predict(context, actions, belief)

    def finished(self, belief: Value) -> bool:
        return self._stop.exists()
