"""Who was refused something at the launch's port: Zenoh tells it in its log alone, so that is read.

Zenoh prints to descriptor 1. While this is watched, what it prints there of links that come in is taken out, and who
had no key of the run is told, with the address; likewise what a certificate does not let somebody do
(`hierax.runtime.watch.denied`). Everything else goes on to where it went before.
"""

import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress

from hierax.runtime.watch.denied import DeniedMessages
from hierax.runtime.watch.tally import Tally

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_OF_LINKS = re.compile(r"(?:DEBUG|WARN|ERROR) .*(zenoh_link_t(?:cp|ls)::unicast|establishment::accept): (.*)")
_CAME = re.compile(r"Accepted T(?:CP|LS) connection on \S+: ([^\s,]+?)\.?(?: |$)")
_FAILED = "Hint: increase"  # what Zenoh guesses whenever a link could not be encrypted
# nobody was refused: somebody looked whether anybody listens, or was cut off, or ended, while a link was opened
_BROKEN = re.compile(r"handshake eof|\(os error \d+\)|Timeout during TLS handshake")
_OVER = "peer certificate: certificate expired"


class RefusedLinks:
    """Takes lines of Zenoh's log, and tells who was refused a link, by machine."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tally = Tally(tell)
        self._came = "somebody"

    def take(self, line: str) -> bool:
        """Whether a line, without colours, is of who comes in."""
        found = _OF_LINKS.search(line)
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
        self._tally.count(host, f"refused {who}: {why}")


_listeners: list[Callable[[str], None]] = []
_called: dict[str, str] = {}


@contextmanager
def overheard(by: Callable[[str], None], called: Mapping[str, str]) -> Iterator[None]:
    """Have somebody told too of who is refused, while this lasts; from a thread of `watched`. `called`: how people call
    the roles that stand in certificates."""
    _listeners.append(by)
    _called.update(called)
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
    links = RefusedLinks(lambda what: _tell_all(what, tell))
    messages = DeniedMessages(lambda what: _tell_all(what, tell), lambda role: _called.get(role, role))

    def read() -> None:
        with open(reading, "rb") as lines:
            for line in lines:
                told = _COLOURS.sub("", line.decode(errors="replace"))
                if not messages.take(told) and not links.take(told):
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
