"""The process from which those of nodes are forked: it has imported what all of them need, and does nothing else.

No thread, session or event loop is there when it forks. What it is told comes in single bytes over its line, a socket,
each with the file descriptors that are for the new process: a socket for its number, a handle and its exit code, its
standard streams, and that of the console. Started by `hierax.runtime.launch.fork_server`, never by hand."""

import gc
import inspect
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from math import inf
from typing import NoReturn

import anyio

from hierax.runtime.launch import node_process
from hierax.runtime.launch.fork_server import DESCRIPTORS, FORK, NUMBER

LEFT_S = 2 * node_process.STUCK_S  # after which what nobody supervises any more is killed: it gives itself half of it
_CONSOLE = 3  # the descriptor of it in a node's process
_MOST = 1 << 20  # no descriptor has a greater number

Living = dict[int, tuple[int, socket.socket]]
"""By the handle of a process its number, and where its exit code goes."""


def main() -> None:
    """Fork until nobody is at the line's other end any more, and all that were forked have ended; they have a while for
    that."""
    line = socket.socket(fileno=int(sys.argv.pop()))
    line.set_inheritable(False)
    anyio.run(anyio.sleep, 0)  # has it import its event loop's parts, 40 ms of work for each node's process else
    inspect.signature(object)  # likewise the patterns with which signatures are read
    gc.collect()
    gc.freeze()  # so that no page is copied because the collector has looked at it
    living: Living = {}
    ready = select.poll()
    ready.register(line, select.POLLIN)
    gone_s = inf
    while gone_s == inf or living:
        left_s = gone_s + LEFT_S - time.monotonic()
        if left_s <= 0:  # they cannot end by themselves: they are stopped, or C code does not give the interpreter back
            _kill_all(living)
        for descriptor, _ in ready.poll(1000 * left_s if 0 < left_s < inf else None):
            if descriptor != line.fileno():
                ready.unregister(descriptor)
                _tell_end(descriptor, *living.pop(descriptor))
                continue
            word, descriptors, _, _ = socket.recv_fds(line, len(FORK), DESCRIPTORS)
            if word:
                _fork(line, ready, living, descriptors)
            else:
                ready.unregister(line)
                gone_s = time.monotonic()
    os._exit(0)


def _kill_all(living: Living) -> None:
    for pid, _ in living.values():
        _kill_group(pid)


def _kill_group(pid: int) -> None:
    """Kill a node's process that has not been waited for, so that the number is its own, with what it has started."""
    with suppress(ProcessLookupError, PermissionError):  # it has ended before it led a group
        os.killpg(pid, signal.SIGKILL)


def _fork(line: socket.socket, ready: select.poll, living: Living, descriptors: Sequence[int]) -> None:
    """Do it; where the system refuses, tell why, and go on for those that live."""
    life = socket.socket(fileno=descriptors[0])
    try:
        pid = os.fork()
    except OSError as error:
        _refuse(life, descriptors[1:], error.errno or 0)
        return
    if not pid:
        for each in (line, life, *(life for _, life in living.values())):
            each.detach()  # their numbers mean something else from now on
        _become_node(descriptors[1:])
    for descriptor in descriptors[1:]:
        os.close(descriptor)
    handle = os.pidfd_open(pid)
    with suppress(OSError):  # who asked does not wait for it any more, and so it ends by itself
        socket.send_fds(life, [NUMBER.pack(pid)], [handle])
    living[handle] = pid, life
    ready.register(handle, select.POLLIN)


def _refuse(life: socket.socket, descriptors: Sequence[int], number: int) -> None:
    """Tell an error's number, with no handle beside it."""
    for descriptor in descriptors:
        os.close(descriptor)
    with suppress(OSError):
        life.send(NUMBER.pack(number))
    life.close()


def _tell_end(handle: int, pid: int, life: socket.socket) -> None:
    """Tell it before the number is given back: who knows of no end yet cannot mean another process by it."""
    _kill_group(pid)
    ended = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    assert ended is not None
    code = ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
    with suppress(OSError):
        life.send(NUMBER.pack(code))
    life.close()
    os.waitpid(pid, 0)
    os.close(handle)


def _become_node(descriptors: Sequence[int]) -> NoReturn:
    """In the new process: have streams and a group of its own, and none of what the others have."""
    try:
        os.setsid()
        for number, descriptor in enumerate(descriptors):
            os.dup2(descriptor, number, inheritable=number != _CONSOLE)
        os.closerange(_CONSOLE + 1, _MOST)
        if "numpy.random" in sys.modules:
            sys.modules["numpy.random"].seed()  # else all would have the same numbers
        node_process.main(_CONSOLE)
    finally:
        os._exit(node_process.BUG)


if __name__ == "__main__":
    main()
