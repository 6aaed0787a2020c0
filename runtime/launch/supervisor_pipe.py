"""What a node's process says to its supervisor."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

from hierax.runtime.execution.world_member import Supervision
from hierax.runtime.launch.frames import ANSWER, BEAT, DISMISS, END, FINISHED, HALT, NOTE, frame
from hierax.runtime.owner.owner import Owner
from hierax.schemas.control import Dismiss
from hierax.schemas.values import Value


class SupervisorPipe(Supervision):
    """The process's end of the pipe; and, in the world's process, how the roster's owner reaches the supervisor."""

    def __init__(self, status: int, on_gone: Callable[[], None]) -> None:
        self._status = status  # file descriptor on which the supervisor listens
        self._on_gone = on_gone  # called when it does not listen any more
        self._saying = threading.Lock()
        self._beating = threading.Lock()
        self._finished = False

    def say(self, status: str, **fields: Value) -> None:
        """Say something, if somebody is still there; any thread may call it."""
        data = memoryview(frame({"status": status, **fields}))
        try:
            with self._saying:
                while data:
                    data = data[os.write(self._status, data) :]
        except BrokenPipeError:
            self._on_gone()

    def end(self, name: str, process: str, why: str) -> None:
        self.say(END, name=name, process=process, why=why)

    def stop(self, why: str) -> None:
        self.say(HALT, why=why)

    def note(self, what: str) -> None:
        self.say(NOTE, what=what)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        self.say(ANSWER, request=request, epoch=epoch, refusal=refusal)

    def dismiss(self, process: str, word: Dismiss) -> None:
        """A process is no part of the hierarchy any more: its supervisor, or this one for it, is to tell it."""
        self.say(DISMISS, process=process, why=word.why, again=word.again)

    def beat(self, owner: Owner) -> None:
        """The world's process lives; and the roster."""
        with self._beating:  # two threads do: what is said last is to be what holds
            roster = owner.roster
            self.say(
                BEAT,
                epoch=owner.epoch,
                version=roster.version,
                instances={name: roster.instance(name) for name in roster.nodes},
                processes=dict(owner.processes),
            )

    def finish(self, owner: Owner) -> None:
        """The last epoch is committed."""
        if not self._finished:
            self._finished = True
            self.say(FINISHED, processes=dict(owner.processes), roster=owner.roster.plain())
