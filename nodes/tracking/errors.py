"""Options out of their range."""

import math
import sys
from collections.abc import Callable

from hierax.nodes.sources.files import DataError


def printed(work: Callable[[], object]) -> int:
    """Print what the work of a program gives; its exit code: 0, or 1 where data is wrong, which is said in one line."""
    try:
        print(work())
    except DataError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
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
