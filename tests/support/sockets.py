"""Links of sessions in this process, broken below Zenoh."""

from __future__ import annotations

import os
import socket

import zenoh


def break_link(one: zenoh.Session, other: zenoh.Session) -> int:
    """Shut the sockets of this process that link two sessions of its; how many there were."""
    links = [link for link in one.info.links() if str(link.zid) == str(other.info.zid())]
    ends = {(_address(link.src), _address(link.dst)) for link in links}
    return sum(_shut(int(name), ends) for name in os.listdir("/proc/self/fd"))


def _shut(file: int, ends: set[tuple[tuple[str, int], tuple[str, int]]]) -> bool:
    try:
        with socket.socket(fileno=os.dup(file)) as each:
            if (each.getsockname(), each.getpeername()) in ends:
                each.shutdown(socket.SHUT_RDWR)
                return True
    except OSError:
        pass  # no socket, or one that listens
    return False


def _address(locator: object) -> tuple[str, int]:
    host, _, port = str(locator).partition("/")[2].rpartition(":")
    return host, int(port)
