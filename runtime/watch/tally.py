"""Counts what is refused, and tells of it in few lines however often it is tried."""

from collections import Counter
from collections.abc import Callable

MAX_KINDS = 64  # how many kinds are counted apart

_OTHERS = "others"


class Tally:
    """Tells of each kind the first time, and whenever its count has doubled; those above `MAX_KINDS` as one."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._counts: Counter[str] = Counter()

    def count(self, kind: str, what: str) -> None:
        """Once more of a kind; `what` is told of it."""
        if kind not in self._counts and len(self._counts) >= MAX_KINDS:
            kind = _OTHERS
        self._counts[kind] += 1
        count = self._counts[kind]
        if not count & (count - 1):
            self._tell(f"{what} ({count} times by now)" if count > 1 else what)
