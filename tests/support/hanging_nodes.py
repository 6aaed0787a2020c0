"""A node in whose process Zenoh hangs as it opens, once: see `HUNG`."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import Any

from hierax.runtime.sim.nodes import Mixer

HUNG = "HIERAX_TEST_HUNG"
"""Environment variable: a file, which is there once a process has hung."""


class Hanging(Mixer):
    """Any node; what hangs is what is around it."""


def hang(*_: Any, **__: Any) -> None:
    """Hang for good, as Zenoh does."""
    Path(os.environ[HUNG]).touch()
    threading.Event().wait()


worker = sys.modules.get("hierax.runtime.launch.node_worker")
if worker is not None and HUNG in os.environ and not Path(os.environ[HUNG]).exists():
    worker.InspectionEndpoint, worker.OPENS_S = hang, 0.5  # type: ignore[attr-defined]
