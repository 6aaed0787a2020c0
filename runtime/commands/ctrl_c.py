"""Ctrl-C, from the first import of a command to the process's end."""

import os
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130
AGAIN_S = 0.01  # after which a Ctrl-C comes again that came where nothing can be raised
LATER_S = 3.0  # after which it does if nobody has taken it: a library that was imported just then has dropped it


class _CtrlC:
    """The first Ctrl-C ends what is being done, the second one the process."""

    came = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            os._exit(INTERRUPTED)
        self.came = True
        self._come_again(LATER_S)
        raise KeyboardInterrupt

    def taken(self) -> None:
        """What was being done has ended."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def swallowed(self, what: "sys.UnraisableHookArgs") -> None:
        """As `sys.unraisablehook`: where nothing can be raised, as in the calls that an import's end makes."""
        if what.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(what)
        elif self.came:
            self._come_again(AGAIN_S)

    def _come_again(self, after_s: float) -> None:
        signal.signal(signal.SIGALRM, self._again)
        signal.setitimer(signal.ITIMER_REAL, after_s, LATER_S)

    def _again(self, number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt


CTRL_C = _CtrlC()


def guarded(main: Callable[[Sequence[str]], int]) -> NoReturn:
    """Do what the command line says by `main`, and end the process. Ctrl-C is never answered by a traceback."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # else who has started it wants it so
        signal.signal(signal.SIGINT, CTRL_C)
        sys.unraisablehook = CTRL_C.swallowed
    try:
        from hierax.runtime.host.streams import own_streams

        own_streams()
        code = main(sys.argv[1:])
        CTRL_C.taken()  # also where a command has answered it by itself
    except BaseException:
        CTRL_C.taken()
        if not CTRL_C.came:  # else it is what a library has made of it
            raise
        code = INTERRUPTED
        print("interrupted", file=sys.stderr)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing is left to be done in good order
    # An interpreter started by `-m` kills itself by SIGINT at its end if the last text that was run by `exec` was
    # broken off by Ctrl-C, as those of a dataclass are, whoever has answered that. So there is another last one.
    exec("")
    sys.exit(code)
