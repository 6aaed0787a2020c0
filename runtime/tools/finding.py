"""What a look at the machine has found."""

from __future__ import annotations

from typing import NamedTuple

FINE, NOTE, WRONG = "fine", "note", "wrong"


class Finding(NamedTuple):
    """What was found in one place.

    Attributes:
        check: what was looked at.
        state: `FINE`, `NOTE` (worth knowing) or `WRONG`.
        what: what is there.
        mend: what to do about it; empty where nothing is to be done.
    """

    check: str
    state: str
    what: str
    mend: str = ""
