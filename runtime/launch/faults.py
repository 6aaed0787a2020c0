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

METHODS = {"act": "act", "commit": "committed"}
"""By place that only the world's process comes to, the method of its member that is called there."""

RECORDS = {"keep": 0, "intent": 1, "acted": 2}
"""By place where the world writes its record: the first or second record of an act; 0: none of an act."""

PLACES = {
    "save": "a node writes its checkpoint",
    "send": "a message goes out",
    "keep": "the world writes its record, before an attempt",
    "act": "the world acts, with what is recorded before and after it",
    "intent": "the world records that it is going to act; its actuators move after it",
    "acted": "the world records that it has acted; its actuators have moved before it",
    "commit": "an epoch is committed",
}
"""Where a process may kill itself, and what happens there."""

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
    strike = _countdown(fault.number)
    if fault.place in ("save", "send"):
        _wrap(member if fault.place == "save" else member.port, fault.place, fault.before, strike)
    elif world is None:
        raise HieraxError(f"--fault {text}: only the world's process comes to {fault.place!r}, not {member.name!r}")
    elif fault.place in RECORDS:
        _plant_at_record(world, fault, strike)
    else:
        _wrap(world, METHODS[fault.place], fault.before, strike)


def _countdown(number: int) -> Callable[[], None]:
    """What kills the process when it has been called a number of times."""
    calls = count(1)

    def strike() -> None:
        if next(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)

    return strike


def _plant_at_record(world: WorldMember, fault: Fault, strike: Callable[[], None]) -> None:
    acts, records = False, 0

    def on_act(begins: bool) -> None:
        nonlocal acts, records
        acts, records = begins, 0

    def on_record() -> None:
        nonlocal records
        records += acts
        if records == RECORDS[fault.place]:
            strike()

    _wrap(world, "act", True, lambda: on_act(True))
    _wrap(world, "act", False, lambda: on_act(False))
    _wrap(world, "write_record", fault.before, on_record)


def _wrap(part: Any, name: str, before: bool, then: Callable[[], None]) -> None:
    method = getattr(part, name)

    def wrapped(*arguments: Any) -> None:
        if before:
            then()
        method(*arguments)
        if not before:
            then()

    setattr(part, name, wrapped)
