"""Whether operators leave alone what they are given; looked at in some epochs, as it takes encoding everything again.

Arrays are frozen in every epoch: this is about lists and dicts, and about belief that was not encoded yet.
"""

from __future__ import annotations

from hierax.runtime.core.binding import Call
from hierax.runtime.core.difference import difference
from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import OperatorError
from hierax.schemas.errors import SchemaError
from hierax.schemas.values import decode_value, encode_value

EVERY = 256
"""Every how many epochs it is looked at; and in those whose number is a power of two, as most faults show at once."""


def is_due(epoch: int) -> bool:
    return not (epoch & (EVERY - 1) and epoch & (epoch - 1))


class Vigilance:
    """What the operators of one node are given in one attempt of an epoch, and must not change."""

    def __init__(self) -> None:
        self._kept: list[tuple[str, Value, bytes]] = []

    def keep(self, what: str, value: Value) -> None:
        """This is given to operators from now on; what cannot be encoded is told when it is to travel."""
        try:
            self._kept.append((what, value, encode_value(value)))
        except SchemaError:
            return

    def check(self, call: Call, epoch: int) -> None:
        """Look at all of it after a call. Raises `OperatorError` if something is not what it was before."""
        for what, value, before in self._kept:
            if _encoded(value) != before:
                raise OperatorError(call.subject, call.operator, epoch, _told(what, value, before))


def _encoded(value: Value) -> bytes:
    try:
        return encode_value(value)
    except SchemaError:
        return b""


def _told(what: str, value: Value, before: bytes) -> str:
    where = difference(decode_value(before), value, (), what)
    return f"changed the {what} that it was given ({where}); make a copy, or a new value"
