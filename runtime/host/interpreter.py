"""How further Python processes are started."""

from __future__ import annotations

import sys
from collections.abc import Sequence

_BEGIN = "import sys; sys.path[:1] == [''] and sys.path.pop(0); del sys.argv[0]; "
"""With `-c` the current folder stands first; until it is gone, nothing is imported. (`-P` is there from 3.11 on.)"""

_AS_MODULE = f"{_BEGIN}import runpy; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"


def python_module(module: str, *arguments: str) -> Sequence[str]:
    """The command that runs a module as ``python -m`` does, but for the current folder.

    Python looks there before anywhere else, so that a user's ``queue.py`` would stand in the place of the standard
    library's. Modules of a deployment's own are found behind all others (`loader.extend_import_path`).
    """
    return [sys.executable, "-c", _AS_MODULE, module, *arguments]


def python_code(code: str, *arguments: str) -> Sequence[str]:
    """The command that runs code, as `python_module` does, with ``sys`` imported, and ``sys.argv`` the arguments."""
    return [sys.executable, "-c", f"{_BEGIN}{code}", *arguments]
