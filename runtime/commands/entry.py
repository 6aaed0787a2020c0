"""The console script, and `python -m hierax.runtime.commands.entry`.

Until there is somebody to answer Ctrl-C in a line, it ends the process without a word."""

import _signal  # type: ignore[import-not-found]  # `signal` imports others, into which Ctrl-C may come

if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

from collections.abc import Sequence

from hierax.runtime.commands.ctrl_c import guarded


def entry() -> None:
    """Do what the command line says, and end the process."""
    guarded(_main)


def _main(arguments: Sequence[str]) -> int:
    from hierax.runtime.commands.main import main

    return main(arguments)


if __name__ == "__main__":
    entry()
