"""What libraries in C and programs print in `hierax run`, where nodes take turns in one process: named.

At a node's turn descriptors 1 and 2 lead to a pipe of that node; what it starts keeps it. Another process reads all of
them: it is there when this one was killed, and while a library prints and holds the interpreter's lock. As a change of
descriptors takes a while, they stay where they are when nobody has printed for long; what is printed first after that
carries the deployment's name.
"""

from __future__ import annotations

import json
import mmap
import os
import select
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress

from hierax.runtime.host.interpreter import python_module, started_deaf
from hierax.runtime.host.streams import own_errors
from hierax.runtime.watch.prints import Console, Lines, flush_c, print_c_by_lines

TURNS = 5_000  # after so many in which nobody has printed, descriptors stay where they are
READ_BYTES = 1 << 16
END_S = 1.0  # how long what was printed may take to be read; programs that are left running keep the reader

Turn = Callable[[str], None]  # told the node whose turn it is


class _Turns:
    def __init__(self, names: Collection[str], otherwise: str, console: int) -> None:
        self._given = [os.dup(1), os.dup(2)]
        pipes = {name: os.pipe() for name in ("", *sorted(names))}  # no node has an empty name
        self._writing = {name: writing for name, (_, writing) in pipes.items()}
        shared = os.memfd_create("printed")
        os.ftruncate(shared, 1)
        self._printed = mmap.mmap(shared, 1)  # not zero when somebody has printed
        reading = {reading: name or otherwise for name, (reading, _) in pipes.items()}
        command = python_module("hierax.runtime.watch.turns", str(console), str(shared), json.dumps(reading))
        with started_deaf():
            self._reader = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=(console, shared, *reading), start_new_session=True
            )
        for descriptor in (shared, *reading):
            os.close(descriptor)
        print_c_by_lines()
        self._left = TURNS
        self._lead_to("")

    def __call__(self, name: str) -> None:
        if self._left:
            if name != self._now:
                self._lead_to(name if name in self._writing else "")
            self._left -= 1
            if not self._left:
                self._lead_to("")
        elif self._printed[0]:
            self._printed[0] = 0
            self._left = TURNS

    def close(self) -> None:
        """Lead them back, when all was read."""
        flush_c()
        for number, descriptor in enumerate(self._given, 1):
            os.dup2(descriptor, number)
        for descriptor in (*self._given, *self._writing.values()):
            os.close(descriptor)
        with suppress(subprocess.TimeoutExpired):
            self._reader.wait(END_S)
        self._reader.returncode = self._reader.returncode or 0  # it is left to itself

    def _lead_to(self, name: str) -> None:
        self._now = name
        for number in (1, 2):
            os.dup2(self._writing[name], number)


@contextmanager
def named_turns(names: Collection[str], otherwise: str) -> Iterator[Turn | None]:
    """While the block runs, what nodes print carries their names, or else another; None: streams are not our own."""
    console = own_errors()
    if console is None:
        yield None
        return
    turns = _Turns(names, otherwise, console)
    try:
        yield turns
    finally:
        turns.close()


def main() -> None:
    """Read what is printed, and show it, until nobody has the pipes any more."""
    console, shared, names = Console(int(sys.argv[1])), int(sys.argv[2]), json.loads(sys.argv[3])
    printed = mmap.mmap(shared, 1)
    lines = {int(reading): Lines(name, console, lambda line: None) for reading, name in names.items()}
    look = select.poll()
    for reading in lines:
        look.register(reading, select.POLLIN)
    while lines:
        for reading, _ in look.poll():
            data = os.read(reading, READ_BYTES)
            printed[0] = 1
            lines[reading].write(data)
            if not data:
                look.unregister(reading)
                lines.pop(reading).end()


if __name__ == "__main__":
    main()
