"""Ends a process in which a call of Zenoh does not return before it has a part in the run, so that nobody misses it."""

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from hierax.runtime import transport

LOOK_S = 1.0
LOOKS = 20  # in so many of them in a row a call has not returned; a process that was stopped does not look meanwhile

_log = logging.getLogger("hierax")
_CALLERS = str(Path(transport.__file__).parent)  # who calls Zenoh
_Place = tuple[int, int]


def watch_for_hangs(name: str, comes: Callable[[], bool]) -> None:
    """Watch this thread for as long as the process, of this name, only `comes` into the run."""
    threading.Thread(target=_watch, args=(threading.get_ident(), name, comes), daemon=True).start()


def _watch(watched: int, name: str, comes: Callable[[], bool]) -> None:
    place: _Place | None = None
    looks = 0
    while comes():
        time.sleep(LOOK_S)
        before, place = place, _place(sys._current_frames().get(watched))
        looks = looks + 1 if place is not None and place == before else 0
        if looks >= LOOKS:
            what = "%s: a call of Zenoh has not returned for %g s; the process ends itself"
            _log.error(what, name, LOOKS * LOOK_S)
            os.kill(os.getpid(), signal.SIGKILL)


def _place(frame: FrameType | None) -> _Place | None:
    """Where a thread is, if a transport has brought it there."""
    caller = frame
    while caller is not None and not caller.f_code.co_filename.startswith(_CALLERS):
        caller = caller.f_back
    return None if frame is None or caller is None else (id(frame), frame.f_lasti)
