"""One error handler for all commands, and the exit codes."""

import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hierax.runtime.commands.ctrl_c import CTRL_C, INTERRUPTED
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import StandardOutputError, drop_output, own_errors, printable
from hierax.schemas.errors import SchemaError

OK, FAILED, USAGE, BUG = range(4)
_LINE_ANEW = "\r\x1b[2K"  # on a terminal a progress bar may stand there, which is drawn again after it
TRACEBACK_VARIABLE = "HIERAX_TRACEBACK"  # set to anything, expected failures show where in the code they arose, too


class CommandError(HieraxError):
    """What a command was told to do cannot be done on this machine."""


class UsageError(CommandError):
    """What a command was told is not what it takes."""


def exit_code(command: Callable[[], int]) -> int:
    """Run a command; its exit code, or, told in a line, that of what failed, with the traceback of a bug."""
    try:
        code = command()
        sys.stdout.flush()
        return code
    except StandardOutputError as error:
        drop_output()
        _say(f"error: {error}")
        return FAILED
    except (HieraxError, SchemaError) as error:
        _show_traceback()
        _say(f"error: {' '.join(str(error).split())}")
        return USAGE if isinstance(error, UsageError) else FAILED
    except KeyboardInterrupt:
        return interrupted()
    except BrokenPipeError:
        # the reader of our output has gone: nothing is left to be told, nor to be flushed at the end
        drop_output()
        return FAILED
    except Exception as error:
        if CTRL_C.came:  # and a library has made an error of it
            return interrupted()
        refused = _refused_file(error)
        if refused:
            _show_traceback()
            _say(f"error: {refused}")
            return FAILED
        traceback.print_exc()
        _say("error: this is a bug, in hierax or in a node: please report it with the lines above")
        return BUG


def _show_traceback() -> None:
    if os.environ.get(TRACEBACK_VARIABLE):
        traceback.print_exc()


def _refused_file(error: Exception) -> str:
    """The file that the system refuses, and why, as in a folder that may not be entered; empty: it is another error."""
    if not isinstance(error, OSError) or not isinstance(error.filename, str | bytes):
        return ""
    return f"{os.fsdecode(error.filename) or repr('')}: {error.strerror}"


def interrupted() -> int:
    """Say that it was interrupted, and return the exit code."""
    CTRL_C.taken()
    _say("interrupted")
    return INTERRUPTED


def _say(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)


def notify(what: str) -> None:
    """Tell people something on standard error while a command goes on."""
    _say(f"hierax: {what}")


@contextmanager
def unhindered() -> Iterator[Callable[[str], None]]:
    """What tells people things as `notify` does, for who keeps processes: where nobody reads standard error, as on a
    terminal that is paused, lines are left out, and nobody waits."""
    from hierax.runtime.watch.prints import Console

    descriptor = own_errors()
    if descriptor is None:  # who has called it has streams of another make
        yield notify
        return
    console, telling = Console(descriptor), threading.Lock()
    begin = _LINE_ANEW if os.isatty(descriptor) else ""

    def tell(what: str) -> None:
        with telling:
            console.write(f"{begin}hierax: {printable(what)}\n".encode(errors="backslashreplace"))

    try:
        yield tell
    finally:
        console.close()
