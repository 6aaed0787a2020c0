"""What a look at the machine has found."""

from __future__ import annotations

from typing import NamedTuple

FINE, NOTE, WRONG = "fine", "note", "wrong"


class Finding(NamedTuple):
    """What was found in one place."""

    check: str  # what was looked at
    state: str  # `FINE`, `NOTE` (worth knowing) or `WRONG`
    what: str  # what is there
    mend: str = ""  # what to do about it; empty where nothing is to be done
