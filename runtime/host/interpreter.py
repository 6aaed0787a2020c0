"""How further Python processes are started: they find no modules in the current folder, and ignore Ctrl-C.

Ctrl-C is for who has started them, who ends them.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

_BEGIN = (
    "import sys; sys.path[:1] == [''] and sys.path.pop(0); del sys.argv[0]; "
    "import _signal; _signal.signal(2, _signal.SIG_IGN); _signal.pthread_sigmask(_signal.SIG_UNBLOCK, {2}); "
)
"""With `-c` the current folder stands first; until it is gone, nothing is imported that is not built in. (`-P` is there
from 3.11 on.)"""

_AS_MODULE = f"{_BEGIN}import runpy; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"


def python_module(module: str, *arguments: str) -> Sequence[str]:
    """The command that runs a module as ``python -m`` does, but for the current folder. Python looks there before
    anywhere else, so that a user's ``queue.py`` would stand in the place of the standard library's. Modules of a
    deployment's own are found behind all others (`loader.extend_import_path`)."""
    return [sys.executable, "-c", _AS_MODULE, module, *arguments]


def python_code(code: str, *arguments: str) -> Sequence[str]:
    """The command that runs code, as `python_module` does, with ``sys`` imported, and ``sys.argv`` the arguments."""
    return [sys.executable, "-c", f"{_BEGIN}{code}", *arguments]


@contextmanager
def started_deaf() -> Iterator[None]:
    """Around the start of processes by `python_module` or `python_code`: Ctrl-C waits until they ignore it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which they inherit
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
