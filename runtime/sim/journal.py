"""What is noted of a simulation: its events in words, and how often each kind of thing occurred."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, get_args

from hierax.runtime.engine.table import Verdict
from hierax.runtime.sim.scenario import FAULTS
from hierax.runtime.transport.rendezvous import DOWN, UP
from hierax.schemas.control import Control, Order
from hierax.schemas.roster import Change

ORDER, WORD, MESSAGE, VERDICT, CHANGE, FAULT = "order", "word", "message", "verdict", "change", "fault"

KINDS: Mapping[str, tuple[str, ...]] = {
    ORDER: tuple(kind.__name__ for kind in get_args(Order)),
    WORD: tuple(kind.__name__ for kind in get_args(Control) if kind not in get_args(Order)),
    MESSAGE: (*UP, *DOWN),
    VERDICT: tuple(verdict.name for verdict in Verdict),
    CHANGE: tuple(kind.__name__ for kind in get_args(Change)),
    FAULT: FAULTS,
}
"""All there is of orders that were obeyed, other words that were heard, messages that came in, what they were judged
to be, changes that were made, and faults that befell something."""

Tally = Counter[tuple[str, str]]  # how often each kind occurred, by what it is a kind of and its name


def control_kind(word: Any) -> tuple[str, str]:
    return (ORDER if isinstance(word, Order) else WORD), type(word).__name__


class Journal:
    """Notes what happens."""

    def __init__(self, now: Callable[[], float], lines: list[str] | None) -> None:
        self.tally: Tally = Counter()  # of all that occurred
        self._now = now  # virtual time in seconds
        self._lines = lines  # where a line for each event goes; None: nowhere

    def trace(self, what: str) -> None:
        if self._lines is not None:
            self._lines.append(f"{self._now():9.4f} {what}")

    def count(self, group: str, kind: str) -> None:
        self.tally[group, kind] += 1
