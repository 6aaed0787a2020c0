"""What a certificate does not let somebody do is told by what was tried, and not by what Zenoh looks up."""

import pytest

from hierax.runtime.watch.denied import DeniedMessages
from hierax.runtime.watch.tally import MAX_KINDS

WHERE = "2030 TRACE  rx-{} ThreadId({}) zenoh::net::routing::interceptor::access_control: "
LINK = "{} on Interface(lo)+CertCommonName({})+Username(hierax)+Transport(Tls)+{} is {} to {} ({}) on {}"
KINDS = (
    "Query",
    "Reply",
    "Put",
    "Delete",
    "Declare/Undeclare Subscriber",
    "Declare/Undeclare Queryable",
    "Declare/Undeclare Liveliness Token",
    "Liveliness Query",
    "Declare Liveliness Subscriber",
)


class Log:
    """What Zenoh prints, by thread, and what is told of it."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self._denied = DeniedMessages(self.told.append, lambda role: f"<{role}>")

    def line(self, what: str, thread: int = 1) -> None:
        assert self._denied.take(f"{WHERE.format(thread, thread)}{what}\n")

    def judged(
        self, what: str, key: str = "a/b", zid: str = "1f", role: str = "r", way: str = "ingress", thread: int = 1
    ) -> None:
        self.line(LINK.format(zid, role, zid, "unauthorized", what, way, key), thread)

    def looked_up(self, key: str, zid: str = "1f", role: str = "r", thread: int = 1) -> None:
        self.line(f"ACL (ingress): caching permissions for `{key}` ...", thread)
        for kind in KINDS:
            self.judged(kind, key, zid, role, thread=thread)


def test_what_is_looked_up_was_not_tried() -> None:
    log = Log()
    log.looked_up("a/b")
    assert not log.told
    log.judged("Put")
    log.line("Using cached result: 1f is unauthorized to Delete (ingress) on a/b")
    log.line("Using cached result: 1f is authorized to Delete (ingress) on a/c")
    assert log.told == ["refused <r>: it may not put on a/b", "refused <r>: it may not delete on a/b"]


def test_threads_are_told_apart() -> None:
    log = Log()
    log.line("ACL (ingress): caching permissions for `a/b` ...", 1)
    log.judged("Query", thread=1)
    log.judged("Put", thread=2)
    for kind in KINDS[1:]:
        log.judged(kind, thread=1)
    assert log.told == ["refused <r>: it may not put on a/b"]


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("Liveliness Token", "it may not claim to live on"),
        ("Declare Queryable", "it may not offer answers on"),
        ("Undeclare Queryable", ""),
        ("Declare Subscriber", "it may not listen on"),
    ],
)
def test_a_try_is_told_in_plain_words(what: str, told: str) -> None:
    log = Log()
    log.judged(what, key="a/\x1b[2J")
    assert log.told == ([f"refused <r>: {told} a/\\x1b[2J"] if told else [])


def test_what_goes_out_is_no_try_of_theirs() -> None:
    log = Log()
    log.judged("Put", way="egress")
    log.line("Access control is enabled")
    assert not log.told


def test_the_launch_s_own_sessions_refuse_one_another_what_is_a_trap_for_others() -> None:
    log = Log()
    log.judged("Declare Subscriber", role="launch")
    assert not log.told


def test_a_flood_is_few_lines_for_each_role_and_kind() -> None:
    log = Log()
    for number in range(1000):
        log.judged("Put", key=f"a/{number}")
    log.judged("Put", zid="2f", role="s")
    assert log.told[1] == "refused <r>: it may not put on a/1 (2 times by now)"
    assert (len(log.told), log.told[-1]) == (11, "refused <s>: it may not put on a/b")
    for number in range(10 * MAX_KINDS):
        log.judged("Put", zid=f"{number:x}aa", role=f"r{number}")
    assert len(log.told) < 11 + MAX_KINDS + 12


def test_other_lines_are_not_taken() -> None:
    assert not DeniedMessages(print, str).take("2030 ERROR net-0 zenoh::net: something else\n")
