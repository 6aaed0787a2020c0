"""A node in whose process Zenoh hangs as it opens, or as it greets its neighbours, once: see `HUNG`."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import Any

from hierax.runtime.sim.nodes import Mixer

HUNG = "HIERAX_TEST_HUNG"
"""Environment variable: a file, which is there once a process has hung."""

GREETS = "greets"
"""Name of the file where it hangs as it greets its neighbours."""


class Hanging(Mixer):
    """Any node; what hangs is what is around it."""


def hang(*_: Any, **__: Any) -> None:
    """Hang for good, as Zenoh does."""
    Path(os.environ[HUNG]).touch()
    threading.Event().wait()


worker, watch = (sys.modules.get(f"hierax.runtime.launch.{name}") for name in ("node_worker", "hang_watch"))
if worker is not None and watch is not None and HUNG in os.environ and not Path(os.environ[HUNG]).exists():
    if Path(os.environ[HUNG]).name == GREETS:
        worker.ZenohPort._put_all, watch.LOOK_S = hang, 0.05  # type: ignore[attr-defined]
    else:
        worker.InspectionEndpoint, worker.OPENS_S = hang, 0.5  # type: ignore[attr-defined]
