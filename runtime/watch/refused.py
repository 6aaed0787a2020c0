"""Who was refused a link at the launch's port: Zenoh tells it in its log alone, so that is read.

Zenoh prints to descriptor 1. While this is watched, what it prints there of links that come in is taken out, and who
had no key of the run is told, with the address; everything else goes on to where it went before.
"""

import os
import re
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

MAX_HOSTS = 64  # how many addresses are counted apart

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_OF_LINKS = re.compile(r"(?:DEBUG|WARN|ERROR) .*(zenoh_link_t(?:cp|ls)::unicast|establishment::accept): (.*)")
_CAME = re.compile(r"Accepted T(?:CP|LS) connection on \S+: ([^\s,]+?)\.?(?: |$)")
_FAILED = "Hint: increase"  # what Zenoh guesses whenever a link could not be encrypted
# nobody was refused: somebody looked whether anybody listens, or was cut off, or ended, while a link was opened
_BROKEN = re.compile(r"handshake eof|\(os error \d+\)|Timeout during TLS handshake")
_OVER = "peer certificate: certificate expired"


class RefusedLinks:
    """Takes lines of Zenoh's log, and tells who was refused: the first time and whenever that has doubled."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._came = "somebody"
        self._refused: Counter[str] = Counter()

    def take(self, line: str) -> bool:
        """Whether a line is of who comes in."""
        found = _OF_LINKS.search(_COLOURS.sub("", line))
        if found is None:
            return False
        where, what = found.groups()
        came = _CAME.match(what)
        if came is not None:
            self._came = came[1]
        elif what.startswith("UsrPwd extension"):
            self._count(self._came, self._came.rpartition(":")[0], "it has no key of this run")
        elif where.startswith("zenoh_link_tls") and _FAILED in what and not _BROKEN.search(what):
            # Zenoh does not tell whom
            ended = _OVER in what
            why = "its certificate has ended" if ended else "it has no certificate of this run"
            self._count("somebody", "ended" if ended else "", why)
        return True

    def _count(self, who: str, host: str, why: str) -> None:
        if host not in self._refused and len(self._refused) >= MAX_HOSTS:
            host = "others"
        self._refused[host] += 1
        count = self._refused[host]
        if not count & (count - 1):
            often = f" ({count} times by now)" if count > 1 else ""
            self._tell(f"refused {who}: {why}{often}")


_listeners: list[Callable[[str], None]] = []


@contextmanager
def overheard(by: Callable[[str], None]) -> Iterator[None]:
    """Have somebody told too of who is refused, while this lasts; from a thread of `watched`."""
    _listeners.append(by)
    try:
        yield
    finally:
        _listeners.remove(by)


@contextmanager
def watched(tell: Callable[[str], None]) -> Iterator[None]:
    """Have who is refused told while this lasts, in a thread of its own."""
    before = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    refused = RefusedLinks(lambda what: _tell_all(what, tell))

    def read() -> None:
        with open(reading, "rb") as lines:
            for line in lines:
                if not refused.take(line.decode(errors="replace")):
                    with suppress(OSError):
                        os.write(before, line)

    reader = threading.Thread(target=read, name="hierax-refused", daemon=True)
    reader.start()
    try:
        yield
    finally:
        os.dup2(before, 1)
        reader.join(1.0)  # a process that has got the pipe from this one may hold it open
        if not reader.is_alive():
            os.close(before)


def _tell_all(what: str, tell: Callable[[str], None]) -> None:
    for each in (tell, *_listeners):
        each(what)
