"""Processes of a launch that kill themselves at a named instant, to show that a run survives it.

A fault is ``INSTANT:N``: SIGKILL at the N-th time, counted from 1, that the process comes to an instant. An instant is
one of `PLACES` with ``.before`` or ``.after``. A launch with `written` ones in its environment has its nodes' processes
import `support.planted.sitecustomize`, which plants them: each process of a node takes the node's next one.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable
from itertools import count
from pathlib import Path
from typing import Any

FOLDER = "HIERAX_TEST_FAULTS"
"""The variable that names the folder of the faults that are left: a file each, by node and number."""

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


def written(folder: Path, faults: Iterable[str]) -> dict[str, str]:
    """The environment of a launch with faults, each as ``NODE:INSTANT:N``; the folder keeps those that are left."""
    folder.mkdir()
    for number, fault in enumerate(faults):
        node, _, text = fault.partition(":")
        (folder / f"{node}.{number:04}").write_text(text, encoding="utf-8")
    return {FOLDER: str(folder)}


def plant_next(member: Any, world: Any) -> None:
    """Have the process kill itself at the next instant of its node's, if any is left. `world`: of the world's alone."""
    for file in sorted(Path(os.environ[FOLDER]).glob(f"{member.name}.*"))[:1]:
        text = file.read_text(encoding="utf-8")
        file.unlink()
        plant(text, member, world)


def plant(text: str, member: Any, world: Any) -> None:
    """Have the process kill itself at ``INSTANT:N``."""
    instant, _, number = text.rpartition(":")
    place, _, side = instant.partition(".")
    part_name, method, record = PLACES[place]
    part = {"member": member, "port": member.port, "world": world}[part_name]
    times, acts, records = count(1), False, 0

    def on_act(begins: bool) -> None:
        nonlocal acts, records
        acts, records = begins, 0

    def strike() -> None:
        nonlocal records
        records += acts
        if record in (None, records) and next(times) == int(number):
            os.kill(os.getpid(), signal.SIGKILL)

    if record is not None:
        _wrap(part, "act", True, lambda: on_act(True))
        _wrap(part, "act", False, lambda: on_act(False))
    _wrap(part, method, {"before": True, "after": False}[side], strike)


def _wrap(part: Any, name: str, before: bool, then: Callable[[], None]) -> None:
    method = getattr(part, name)

    def wrapped(*arguments: Any) -> None:
        if before:
            then()
        method(*arguments)
        if not before:
            then()

    setattr(part, name, wrapped)
