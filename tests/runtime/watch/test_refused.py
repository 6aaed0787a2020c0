"""Who was refused is taken out of what Zenoh prints, and told in few lines."""

import os
from importlib.metadata import version

import pytest

from hierax.runtime.transport.zenoh_session import READ_VERSIONS
from hierax.runtime.watch.refused import OPENS_S, RefusedLinks, watched
from hierax.runtime.watch.tally import MAX_KINDS

_LINK, _ACCEPT = "zenoh_link_tcp::unicast", "zenoh_transport::unicast::establishment::accept"
_DOOR = "zenoh_link_unixsock_stream::unicast"
CAME = f"2030 DEBUG acc-0 {_LINK}: Accepted TCP connection on 127.0.0.1:1: {{}}\n"
REFUSED = f"2030 DEBUG acc-0 {_ACCEPT}: UsrPwd extension - Recv InitSyn. Expected extension.\n"
ENDED = f"2030 DEBUG acc-0 {_ACCEPT}: Read error on TCP link\n"


def test_a_flood_of_refusals_is_few_lines() -> None:
    told: list[str] = []
    links = RefusedLinks(told.append)
    for number in range(1000):
        links.take(CAME.format(f"10.0.0.7:{number}"))
        links.take(REFUSED)
        assert links.take(ENDED)
    assert told[:2] == [
        "refused 10.0.0.7:0: it has no key of this run",
        "refused 10.0.0.7:1: it has no key of this run (2 times by now)",
    ]
    assert len(told) == 10
    for number in range(10 * MAX_KINDS):
        links.take(CAME.format(f"10.1.{number}.7:1"))
        links.take(REFUSED)
    assert len(told) < 10 + MAX_KINDS + 12


def test_nobody_is_named_for_another_one() -> None:
    told: list[str] = []
    now = 0.0
    links = RefusedLinks(told.append, clock=lambda: now)
    links.take(CAME.format("10.0.0.7:1"))
    links.take(CAME.format("10.0.0.8:1"))
    links.take(REFUSED)
    links.take(CAME.format("10.0.0.5:1"))
    now = OPENS_S + 1
    links.take(CAME.format("10.0.0.9:1"))
    links.take(CAME.format("10.0.0.9:2"))
    links.take(REFUSED)
    links.take(REFUSED)
    links.take(REFUSED)
    assert told == [
        "refused somebody: it has no key of this run",
        "refused somebody at 10.0.0.9: it has no key of this run",
        "refused 10.0.0.9:2: it has no key of this run (2 times by now)",
        "refused somebody: it has no key of this run",
    ]


def test_who_has_got_a_link_was_not_refused_one() -> None:
    told: list[str] = []
    links = RefusedLinks(told.append, by="low")
    door = f'2030 DEBUG acc-0 {_DOOR}: Accepted UnixSocketStream connection on: "/a/0.door" (pathname)\n'
    for came, dst in ((CAME.format("10.0.0.7:1"), "tcp/10.0.0.7:1"), (door, "unixsock-stream/5fc2")):
        assert links.take(came)
        link = f"TransportLinkUnicast {{ link: Link {{ src: tcp/10.0.0.1:7, dst: {dst}, is_streamed: true }} }}"
        assert links.take(f"2030 DEBUG acc-0 {_ACCEPT}: New transport link accepted from 1f to 2f: {link}\n")
    links.take(CAME.format("10.0.0.8:1"))
    links.take(REFUSED)
    links.take(door)
    links.take(REFUSED)
    assert told == [
        "low: refused 10.0.0.8:1: it has no key of this run",
        "low: refused somebody at its socket in the run's folder: it has no key of this run",
    ]


def test_the_words_of_this_zenoh_are_known() -> None:
    assert version("eclipse-zenoh").startswith(READ_VERSIONS)


def test_what_is_printed_goes_on_where_nobody_can_be_told(capfd: pytest.CaptureFixture[str]) -> None:
    def broken(what: str) -> None:
        raise BrokenPipeError

    with watched(broken):
        os.write(1, CAME.format("10.0.0.7:5").encode() + REFUSED.encode())
        os.write(1, b"a library says this\n")
    assert capfd.readouterr().out == "a library says this\n"


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("received fatal alert: UnknownCA", "it has no certificate of this run"),
        ("received corrupt message of type InvalidContentType", "it has no certificate of this run"),
        (
            "invalid peer certificate: certificate expired: verification time 2 (UNIX)",
            "its certificate has ended",
        ),
        ("tls handshake eof", ""),
        ("Connection reset by peer (os error 104)", ""),
        ("Timeout during TLS handshake", ""),
    ],
)
def test_who_shows_no_certificate_is_told_apart_from_whose_has_ended_and_from_links_that_broke(
    what: str, told: str
) -> None:
    lines: list[str] = []
    links = RefusedLinks(lines.append)
    assert links.take(f"2030  WARN acc-0 zenoh_link_tls::unicast: {what}. Hint: increase the system open file limit.\n")
    assert lines == ([f"refused somebody: {told}"] if told else [])


def test_what_else_is_printed_goes_where_it_went(capfd: pytest.CaptureFixture[str]) -> None:
    told: list[str] = []
    with watched(told.append):
        os.write(1, b"a library says this\n")
        os.write(1, CAME.format("10.0.0.7:5").encode() + REFUSED.encode())
        os.write(1, b"2030 ERROR net-0 zenoh::net: something else\n")
    os.write(1, b"and this\n")
    assert capfd.readouterr().out == "a library says this\n2030 ERROR net-0 zenoh::net: something else\nand this\n"
    assert told == ["refused 10.0.0.7:5: it has no key of this run"]
