"""Who was refused something: Zenoh tells it in its log alone, so that is read.

Zenoh prints to descriptor 1. While this is watched, what it prints there of links that come in is taken out, and who
had no key of the run is told, with the address; likewise what a certificate does not let somebody do
(`hierax.runtime.watch.denied`). Everything else goes on to where it went before. What is printed of links in processes
of nodes comes to who overhears them (`hierax.runtime.launch.child`), and is taken out there.
"""

import os
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import MappingProxyType

from hierax.runtime.watch.denied import DeniedMessages
from hierax.runtime.watch.tally import Tally

OPENS_S = 10.0  # how long Zenoh has somebody open a link
MAX_OPENING = 64  # links of which it is known who opens them

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_OF_LINKS = re.compile(
    r"(?:DEBUG|WARN|ERROR) .*(zenoh_link_(?:tcp|tls|unixsock_stream)::unicast|establishment::accept): (.*)"
)
_CAME = re.compile(r"Accepted (?:T(?:CP|LS) connection on \S+: (?P<address>[^\s,]+?)\.?(?: |$)|UnixSocketStream)")
_LET_IN = re.compile(
    r"New transport link accepted from .*? dst: (?:(?:tcp|tls)/(?P<address>[^\s,?#]+)|unixsock-stream/)"
)
_AT_THE_DOOR = "somebody at its socket in the run's folder"
_FAILED = "Hint: increase"  # what Zenoh guesses whenever a link could not be encrypted
# nobody was refused: somebody looked whether anybody listens, or was cut off, or ended, while a link was opened
_BROKEN = re.compile(r"handshake eof|\(os error \d+\)|Timeout during TLS handshake")
_OVER = "peer certificate: certificate expired"


class RefusedLinks:
    """Takes lines of Zenoh's log, and tells who was refused a link, by machine.

    Args:
        tell: told what is to be told.
        by: whose process has refused it; empty: this one.
        clock: seconds.
    """

    def __init__(self, tell: Callable[[str], None], by: str = "", clock: Callable[[], float] = time.monotonic) -> None:
        self._by = f"{by}: " if by else ""
        self._tally = Tally(tell)
        self._clock = clock  # seconds
        self._opening: deque[tuple[float, str]] = deque(maxlen=MAX_OPENING)  # since when, and who

    def take(self, line: str) -> bool:
        """Whether a line, without colours, is of who comes in."""
        found = _OF_LINKS.search(line)
        if found is None:
            return False
        where, what = found.groups()
        came = _CAME.match(what)
        if came is not None:
            self._opening.append((self._clock(), came["address"] or _AT_THE_DOOR))
        elif let_in := _LET_IN.match(what):
            self._is_linked(let_in["address"] or _AT_THE_DOOR)
        elif what.startswith("UsrPwd extension"):
            who, host = self._who()
            self._count(who, host, "it has no key of this run")
        elif where.startswith("zenoh_link_tls") and _FAILED in what and not _BROKEN.search(what):
            # Zenoh does not tell whom
            ended = _OVER in what
            why = "its certificate has ended" if ended else "it has no certificate of this run"
            self._count("somebody", "ended" if ended else "", why)
        return True

    def _is_linked(self, who: str) -> None:
        for opening in self._opening:
            if opening[1] == who:
                self._opening.remove(opening)
                return

    def _who(self) -> tuple[str, str]:
        """Who was refused, and its machine. Zenoh says who comes, and then that somebody was refused: with several that
        come at once it is one of them, and it is not said which."""
        while self._opening and self._clock() - self._opening[0][0] > OPENS_S:
            self._opening.popleft()
        hosts = {address.rpartition(":")[0] or address for _, address in self._opening}
        if len(hosts) != 1:
            return "somebody", ", ".join(sorted(hosts))
        (host,) = hosts
        only = len(self._opening) == 1
        _, address = self._opening.popleft()
        return (address if only or address == host else f"somebody at {host}"), host

    def _count(self, who: str, host: str, why: str) -> None:
        self._tally.count(host, f"{self._by}refused {who}: {why}")


def plain(line: str) -> str:
    """A line without colours."""
    return _COLOURS.sub("", line)


_listeners: list[Callable[[str], None]] = []
_called: dict[str, str] = {}


@contextmanager
def overheard(by: Callable[[str], None], called: Mapping[str, str] = MappingProxyType({})) -> Iterator[None]:
    """Have somebody told too of who is refused, while this lasts; from any thread. `called`: how people call the roles
    that stand in certificates."""
    _listeners.append(by)
    _called.update(called)
    try:
        yield
    finally:
        _listeners.remove(by)
        for role in called:
            _called.pop(role, None)


@contextmanager
def watched(tell: Callable[[str], None]) -> Iterator[None]:
    """Have who is refused told while this lasts, in a thread of its own."""
    before = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    links, messages = RefusedLinks(tell_all), DeniedMessages(tell_all, lambda role: _called.get(role, role))
    _listeners.insert(0, tell)

    def read() -> None:
        with open(reading, "rb") as lines:
            for line in lines:
                told = plain(line.decode(errors="replace"))
                with suppress(OSError):  # nobody reads any more what is told, or printed
                    if not messages.take(told) and not links.take(told):
                        os.write(before, line)

    reader = threading.Thread(target=read, name="hierax-refused", daemon=True)
    reader.start()
    try:
        yield
    finally:
        os.dup2(before, 1)
        reader.join(1.0)  # a process that has got the pipe from this one may hold it open
        _listeners.remove(tell)
        if not reader.is_alive():
            os.close(before)


def tell_all(what: str) -> None:
    """Tell who watches, or wants to be told too."""
    for each in (*_listeners,):
        each(what)
