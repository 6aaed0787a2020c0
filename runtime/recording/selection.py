"""What of a run is recorded: keys that are left out, and how large or long a recording may become."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.info import RecordingError

KINDS = ("obs", "task", "ctx", "steps", "notes", "control", "alive")
"""What a key begins with that may be left out; the roster and the digests are always recorded."""

_ROOT_SEGMENTS = 3
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?)(i?)B?")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*([smhd]?)")
_POWERS = {"": 0, "k": 1, "M": 2, "G": 3, "T": 4}
_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


@dataclass(frozen=True)
class Selection:
    """What of a run is recorded."""

    exclude: Sequence[str] = ()  # patterns of keys, as `leaves_out` has them
    max_bytes: int | None = None  # of the file; None: no bound
    max_duration_s: float | None = None  # None: no bound

    def leaves_out(self, key: str) -> str:
        """The pattern by which what comes on a key is left out; empty: it is recorded."""
        names = key.split("/")[_ROOT_SEGMENTS:]
        return next((pattern for pattern in self.exclude if _fits(pattern.split("/"), names)), "")


EVERYTHING = Selection()


def check_pattern(pattern: str) -> str:
    """A pattern of keys to be left out, such as ``obs/camera/*``. Its parts stand for those of a key, with ``*`` for
    anything in one and ``?`` for any letter; ``**`` at its end stands for all that is left. Raises `RecordingError` if
    no key that may be left out is like it."""
    head = pattern.split("/")[0]
    if "" in pattern.split("/") or not any(head == "**" or fnmatchcase(kind, head) for kind in KINDS):
        near = did_you_mean(head, KINDS, "they begin with")
        raise RecordingError(f"--exclude {pattern}: expected a pattern of keys, such as obs/camera/*{near}")
    return pattern


def read_size(text: str) -> int:
    """Bytes, such as ``500 MB`` or ``2GiB``. Raises `RecordingError` if it is no size."""
    found = _measured(_SIZE, text, "--max-size", "a size, such as 500MB or 2GiB")
    return int(float(found[1]) * (1024 if found[3] else 1000) ** _POWERS[found[2]])


def read_duration(text: str) -> float:
    """Seconds, such as ``90``, ``90s``, ``15m`` or ``2h``. Raises `RecordingError` if it is no time."""
    found = _measured(_DURATION, text, "--max-duration", "a time, such as 90s, 15m or 2h")
    return float(found[1]) * _SECONDS[found[2]]


def _measured(pattern: re.Pattern[str], text: str, option: str, expected: str) -> re.Match[str]:
    found = pattern.fullmatch(text.strip())
    if found is None or not float(found[1]):
        raise RecordingError(f"{option} {text}: expected {expected}")
    return found


def _fits(pattern: Sequence[str], names: Sequence[str]) -> bool:
    if names[0] not in KINDS:
        return False
    if pattern[-1] == "**":
        pattern = [*pattern[:-1], *("*" for _ in range(len(names) - len(pattern) + 1))]
    return len(pattern) == len(names) and all(map(fnmatchcase, names, pattern))
