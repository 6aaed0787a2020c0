"""What two threads of the world's process say to the supervisor: the roster that is told last is the one in force."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from typing import Any, cast

from hierax.runtime.launch.frames import Frames, SupervisorPipe
from hierax.runtime.owner.owner import Owner
from hierax.schemas.roster import Reference, Roster

WAIT_S = 20.0


class SlowOwner:
    """One whose processes are read slowly, the first time."""

    epoch = 1

    def __init__(self) -> None:
        self.tokens = {"world": "w"}
        self.reading = threading.Event()
        self.go_on = threading.Event()
        self.members = self.progress = self

    @property
    def roster(self) -> Roster:
        return Roster("world", dict.fromkeys(self.tokens, Reference("toys:Node")), ())

    @property
    def processes(self) -> Mapping[str, str]:
        tokens = dict(self.tokens)
        if not self.reading.is_set():
            self.reading.set()
            assert self.go_on.wait(WAIT_S)
        return tokens


def test_what_was_read_before_a_change_is_not_said_after_it() -> None:
    reader, writer = os.pipe()
    owner = SlowOwner()
    pipe = SupervisorPipe(writer, lambda: None)
    ticking = threading.Thread(target=pipe.beat, args=(cast(Owner, owner),))
    ticking.start()
    assert owner.reading.wait(WAIT_S)
    owner.tokens = {"world": "w", "top": "t"}
    changing = threading.Thread(target=pipe.beat, args=(cast(Owner, owner),))
    changing.start()
    changing.join(0.2)  # it has said it, or waits
    owner.go_on.set()
    for thread in (ticking, changing):
        thread.join(WAIT_S)
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        said: list[dict[str, Any]] = Frames().feed(stream.read())
    assert [sorted(beat["processes"]) for beat in said] == [["world"], ["top", "world"]]
