"""Who has tried what its certificate does not let it: Zenoh tells that in its log alone, where that says all there is.

Zenoh looks up what a role may do with a key whenever somebody declares one, and prints all that it finds, though nobody
has tried any of it. That is told apart here from what was tried.
"""

import re
from collections.abc import Callable

from hierax.runtime.watch.tally import Tally
from hierax.schemas.access import LAUNCH

_OF_LISTS = re.compile(r"(?P<thread>ThreadId\(\d+\)) zenoh::net::routing::interceptor::access_control: (?P<what>.*)")
_LOOKS_UP = re.compile(r"ACL \((?:in|e)gress\): caching permissions for `(?P<key>.*)` \.\.\.$")
_DENIED = re.compile(
    r"(?P<again>Using cached result: )?(?P<zid>[0-9a-f]+)(?: on (?P<link>\S.*?))?"
    r" is unauthorized to (?P<message>[A-Z][A-Za-z/ ]*) \(ingress\) on (?P<key>.*)"
)
_ROLE = re.compile(r"CertCommonName\(([^)]*)\)")
_IN_A_LOOK = 9  # kinds of messages that Zenoh looks up for a key
_MAX_SESSIONS = 256  # whose roles are known by their ids

_TRIED = {
    "Put": "put",
    "Delete": "delete",
    "Query": "ask",
    "Reply": "answer",
    "Declare Queryable": "offer answers",
    "Declare Subscriber": "listen",
    "Liveliness Token": "claim to live",
    "Declare Liveliness Subscriber": "watch who lives",
    "Liveliness Query": "ask who lives",
}
"""By what Zenoh calls a message, what somebody does who sends it; who takes something back has tried it before."""


class DeniedMessages:
    """Takes lines of Zenoh's log, and tells who has tried what, by the name in its certificate."""

    def __init__(self, tell: Callable[[str], None], called: Callable[[str], str]) -> None:
        self._tally = Tally(tell)
        self._called = called  # how people call who has a name in a certificate
        # by thread, the key that is looked up, and how many lines are left
        self._looks: dict[str, tuple[str, int]] = {}
        self._roles: dict[str, str] = {}  # by a session's id

    def take(self, line: str) -> bool:
        """Whether a line, without colours, is of the lists of who may do what."""
        found = _OF_LISTS.search(line)
        if found is None:
            return False
        thread, what = found.groups()
        looks_up = _LOOKS_UP.match(what)
        if looks_up is not None:
            self._looks[thread] = looks_up["key"], _IN_A_LOOK
        elif "authorized to" in what:
            self._learn(what)
            if not self._is_looked_up(thread, what):
                self._judge(what)
        return True

    def _is_looked_up(self, thread: str, what: str) -> bool:
        """Whether a line is one of those that Zenoh prints as it looks up a key."""
        key, left = self._looks.get(thread, ("", 0))
        if not left or what.startswith("Using cached") or not what.endswith(f" on {key}"):
            return False
        self._looks[thread] = key, left - 1
        return True

    def _judge(self, what: str) -> None:
        denied = _DENIED.match(what)
        if denied is None or denied["message"] not in _TRIED:
            return
        role = self._roles.get(denied["zid"], "somebody")
        if role == LAUNCH:
            return  # another session of this process, which does not hear what is listened to here for who is refused
        who = self._called(role)
        tried, key = _TRIED[denied["message"]], denied["key"]
        self._tally.count(f"{who} {tried}", f"refused {who}: it may not {tried} on {ascii(key)[1:-1]}")

    def _learn(self, what: str) -> None:
        """Which role a session has; where it is looked up once, Zenoh names the session alone afterwards."""
        zid, role = what.partition(" ")[0], _ROLE.search(what)
        if role is not None and zid not in self._roles:
            if len(self._roles) >= _MAX_SESSIONS:
                self._roles.pop(next(iter(self._roles)))
            self._roles[zid] = role[1]
