"""Processes that kill themselves at a named instant, to show that a run survives it.

A fault is ``INSTANT:N``: SIGKILL at the N-th time, counted from 1, that the process comes
to an instant. An instant is one of `PLACES` with ``.before`` or ``.after``.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable
from itertools import count
from typing import Any, NamedTuple

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.loading.nearest import did_you_mean

PLACES: dict[str, tuple[str, str, int | None]] = {
    "save": ("member", "save", None),  # a node writes its checkpoint
    "send": ("port", "send", None),  # a message goes out
    "keep": ("world", "write_record", 0),  # the world writes its record, before an attempt
    "act": ("world", "act", None),  # the world acts, with what is recorded before and after it
    "intent": ("world", "write_record", 1),  # the world records that it is going to act; its actuators move after it
    "acted": ("world", "write_record", 2),  # the world records that it has acted; its actuators have moved before it
    "commit": ("world", "committed", None),  # an epoch is committed
}
"""Where a process may kill itself: the part, its method, and of records which one of an act; 0: none of an act."""

INSTANTS = tuple(f"{place}.{side}" for place in PLACES for side in ("before", "after"))


class Fault(NamedTuple):
    """The instant at which a process dies, and how often it comes there before."""

    place: str  # one of `PLACES`
    before: bool  # whether it is before what happens there
    number: int  # from 1

    @staticmethod
    def read(text: str) -> Fault:
        """Read a fault from ``INSTANT:N``. Raises `HieraxError` if that is none."""
        instant, _, number = text.rpartition(":")
        if instant not in INSTANTS:
            raise HieraxError(f"--fault {text}: {instant!r} is no instant{did_you_mean(instant, INSTANTS, 'they are')}")
        if not number.isdecimal() or int(number) < 1:
            raise HieraxError(f"--fault {text}: expected INSTANT:N with N from 1")
        place, _, side = instant.partition(".")
        return Fault(place, side == "before", int(number))


def read_faults(texts: Iterable[str]) -> dict[str, list[str]]:
    """Faults by node, each in their order, from ``NODE:INSTANT:N``. Raises `HieraxError` if one is none."""
    found: dict[str, list[str]] = {}
    for text in texts:
        name, _, fault = text.partition(":")
        Fault.read(fault)
        found.setdefault(name, []).append(fault)
    return found


def plant(text: str, member: Member, world: WorldMember | None) -> None:
    """Have the process kill itself at ``INSTANT:N``. Raises `HieraxError` if that is none of this process."""
    fault = Fault.read(text)
    part_name, method, record = PLACES[fault.place]
    part = {"member": member, "port": member.port, "world": world}[part_name]
    if part is None:
        raise HieraxError(f"--fault {text}: only the world's process comes to {fault.place!r}, not {member.name!r}")
    times, acts, records = count(1), False, 0

    def on_act(begins: bool) -> None:
        nonlocal acts, records
        acts, records = begins, 0

    def strike() -> None:
        nonlocal records
        records += acts
        if record in (None, records) and next(times) == fault.number:
            os.kill(os.getpid(), signal.SIGKILL)

    if record is not None:
        _wrap(part, "act", True, lambda: on_act(True))
        _wrap(part, "act", False, lambda: on_act(False))
    _wrap(part, method, fault.before, strike)


def _wrap(part: Any, name: str, before: bool, then: Callable[[], None]) -> None:
    method = getattr(part, name)

    def wrapped(*arguments: Any) -> None:
        if before:
            then()
        method(*arguments)
        if not before:
            then()

    setattr(part, name, wrapped)
