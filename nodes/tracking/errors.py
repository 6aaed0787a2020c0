"""Options out of their range."""

import math
import sys
from collections.abc import Callable

from hierax.nodes.sources.files import DataError
from hierax.runtime.host.streams import drop_output

_FAILED, _INTERRUPTED = 1, 130  # exit codes, as those of hierax's commands


def printed(work: Callable[[], object]) -> int:
    """Print what the work of a program gives; its exit code: 0, or 1 where data is wrong, which is said in one line, or
    where nobody reads what is printed any more, or 130 after Ctrl-C."""
    try:
        print(work(), flush=True)
    except DataError as error:
        print(f"error: {error}", file=sys.stderr)
        return _FAILED
    except BrokenPipeError:
        drop_output()  # nothing is left to be told, nor to be flushed at the end
        return _FAILED
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return _INTERRUPTED
    return 0


def check_positive(**numbers: float) -> None:
    """See that options, by name, are finite numbers above 0; ValueError."""
    for name, number in numbers.items():
        if not 0.0 < number < math.inf:
            raise ValueError(f"{name} is {number}; expected a positive number")


def check_between(least: float, most: float, kind: str, **numbers: float) -> None:
    """See that options, by name, are from `least` to `most`, "a number" or whatever kind they are; ValueError."""
    for name, number in numbers.items():
        if not least <= number <= most:
            raise ValueError(f"{name} is {number}; expected {kind} from {least} to {most:g}")
