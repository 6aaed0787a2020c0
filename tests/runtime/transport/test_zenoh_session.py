"""Sessions: settings of the user's win, and nothing is left behind."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import pytest
import zenoh
from cryptography import x509
from support.live import until

from hierax.runtime.host.run_certificates import certificates, new_authority
from hierax.runtime.host.run_secret import issued, new_secret
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import (
    ENCRYPTION,
    LOW_LATENCY_BYTES,
    close_session,
    door_at,
    encrypted,
    endpoint_at,
    free_endpoint,
    knocking_at,
    open_session,
    orphaned_segments,
    remove_orphaned_segments,
)


def test_it_listens_on_loopback_only() -> None:
    before = listening()
    session = open_session()
    opened = listening() - before
    close_session(session)
    assert opened
    assert all(address.startswith("0100007F:") for address in opened), opened


def test_who_is_told_of_doors_links_to_these_alone_and_again_when_somebody_comes_back(tmp_path: Path) -> None:
    hub = open_session([endpoint := free_endpoint()], links="told")
    doors = {name: str(tmp_path / name) for name in ("low", "up", "beside")}

    def told(name: str, *others: str) -> zenoh.Session:
        listen = [endpoint_at(), door_at(doors[name])]
        return open_session(listen, [endpoint, *(knocking_at(doors[other]) for other in others)], links="told")

    up = told("up", "low")  # whose door is not there yet
    low, beside = told("low"), told("beside")
    try:
        until(lambda: peers(up) == zids(hub, low), "links to the hub and the door")
        close_session(low)
        until(lambda: peers(up) == zids(hub), "a link that is gone")
        low = told("low")
        until(lambda: peers(up) == zids(hub, low), "another link")
        newcomer = open_session([endpoint_at()], [endpoint])
        until(lambda: peers(newcomer) == zids(hub, low, up, beside), "links to all")
        close_session(newcomer)
        until(lambda: peers(up) == zids(hub, low), "links as before")
        until(lambda: peers(beside) == zids(hub), "links of the one beside as before")
    finally:
        for session in (up, low, beside, hub):
            close_session(session)


def test_of_two_that_come_at_once_one_opens_the_link(tmp_path: Path) -> None:
    """Where both do, some are left unlinked for good."""
    hub = open_session([endpoint := free_endpoint()], links="told")
    doors = [str(tmp_path / str(number)) for number in range(2)]
    told = [open_session([endpoint_at(), door_at(door)], [endpoint], links="told") for door in doors]
    gate = threading.Barrier(5)

    def come() -> zenoh.Session:
        gate.wait()
        return open_session(connect=[endpoint])

    try:
        with ThreadPoolExecutor(5) as pool:
            for _ in range(3):
                came = [each.result() for each in [pool.submit(come) for _ in range(5)]]
                for one in came:
                    others = zids(hub, *told, *came) - zids(one)
                    until(lambda one=one, others=others: peers(one) >= others, "links to all")
                list(pool.map(close_session, came))
    finally:
        for session in (*told, hub):
            close_session(session)


def peers(session: zenoh.Session) -> set[str]:
    """To whom a session is linked."""
    return set(map(str, session.info.peers_zid()))


def zids(*sessions: zenoh.Session) -> set[str]:
    return {str(session.zid()) for session in sessions}


def listening() -> set[str]:
    """Local addresses of this process's and others' listening TCP sockets, as the kernel writes them."""
    lines = [
        line.split() for path in ("/proc/net/tcp", "/proc/net/tcp6") for line in Path(path).read_text().splitlines()
    ]
    return {fields[1] for fields in lines if fields[3] == "0A"}


@pytest.mark.parametrize("form", ["map", "text", "file"])
def test_settings_of_the_user_s_win(form: str, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    text = f'{{listen: {{endpoints: ["{endpoint}"]}}}}'
    (tmp_path / "zenoh.json5").write_text(text)
    forms = {"map": {"listen": {"endpoints": [endpoint]}}, "text": text, "file": str(tmp_path / "zenoh.json5")}
    session = open_session(zenoh_config=forms[form])
    port = f"{int(endpoint.rpartition(':')[2]):04X}"
    found = [address for address in listening() if address.endswith(f":{port}")]
    close_session(session)
    assert found


def test_the_file_that_zenoh_config_names_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint = free_endpoint()
    (tmp_path / "zenoh.json5").write_text(f'{{listen: {{endpoints: ["{endpoint}"]}}}}')
    monkeypatch.setenv("ZENOH_CONFIG", str(tmp_path / "zenoh.json5"))
    session = open_session()
    port = f"{int(endpoint.rpartition(':')[2]):04X}"
    found = [address for address in listening() if address.endswith(f":{port}")]
    close_session(session)
    assert found


def test_low_latency_is_not_to_be_had_by_zenoh_s_settings_alone() -> None:
    settings = "{transport: {unicast: {lowlatency: true, qos: {enabled: false}}}}"
    with pytest.raises(TransportError, match="long messages get lost; leave it out: low_latency: true in"):
        open_session(zenoh_config=settings, low_latency=True)
    settings = "{transport: {link: {tx: {batch_size: 8192}}}}"
    with pytest.raises(TransportError, match="batch_size, which bounds what low-latency links carry"):
        open_session(zenoh_config=settings, low_latency=True)


@pytest.mark.parametrize("low_latency", [False, True])
def test_low_latency_links_carry_no_long_messages(low_latency: bool) -> None:
    """What Zenoh does, and why ports refuse them; the short message that follows a long one tells when to look."""
    endpoint = free_endpoint()
    sender = open_session([endpoint], low_latency=low_latency, shared_memory=False)
    sizes: list[int] = []
    receivers = []

    def listen() -> None:
        receivers.append(open_session(connect=[endpoint], low_latency=low_latency, shared_memory=False))
        receivers[-1].declare_subscriber("long", lambda sample: sizes.append(len(sample.payload.to_bytes())))

    listen()
    try:
        publisher = sender.declare_publisher("long", congestion_control=zenoh.CongestionControl.BLOCK)
        until(lambda: publisher.matching_status.matching, "they know one another")
        for size in (LOW_LATENCY_BYTES, 100_000):
            publisher.put(bytes(size))

        def has_come() -> bool:
            if low_latency and len(receivers) == 1 and not receivers[0].info.peers_zid():
                listen()  # the link was closed, and Zenoh does not always open it again
            publisher.put(b".")
            return 1 in sizes

        until(has_come, "the message after the long one")
        long = [size for size in sizes if size != 1]
        assert long == ([LOW_LATENCY_BYTES] if low_latency else [LOW_LATENCY_BYTES, 100_000])
    finally:
        for session in (*receivers, sender):
            close_session(session)


def test_refused_links_are_one_error_of_ours_and_no_lines_of_zenoh_s(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "passwords").write_text("anna:right\n")
    endpoint = free_endpoint()

    def settings(password: str) -> dict[str, Any]:
        who = {"user": "anna", "password": password, "dictionary_file": str(tmp_path / "passwords")}
        return {"transport": {"auth": {"usrpwd": who}}, "connect": {"timeout_ms": 500}}

    session = open_session([endpoint], zenoh_config=settings("right"))
    try:
        with pytest.raises(TransportError, match=r"Zenoh: Unable to connect to any of .*Timeout!"):
            open_session((), [endpoint], settings("wrong"), mode="client")
    finally:
        close_session(session)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("settings", ["{mode: }", '{mode: "king"}', "there/is/no/such.json5"])
def test_settings_that_zenoh_refuses_are_one_clear_error(settings: str) -> None:
    with pytest.raises(TransportError, match="Zenoh: "):
        open_session(zenoh_config=settings)


def test_orphaned_segments_are_removed_and_those_in_use_are_not() -> None:
    module = "hierax.runtime.transport.zenoh_session"
    code = f"import sys; from {module} import open_session; s = open_session(); print(flush=True); sys.stdin.read()"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.readline()
    used = held_by(child.pid)
    assert used
    remove_orphaned_segments()
    assert all(segment.exists() for segment in used)
    child.kill()
    child.communicate()
    remove_orphaned_segments()
    assert not any(segment.exists() for segment in used)


def test_a_link_among_segments_is_not_followed(tmp_path: Path) -> None:
    """In /dev/shm anybody may make one, to whatever is to be opened or locked."""
    (tmp_path / "precious").touch()
    (tmp_path / "link.zenoh").symlink_to(tmp_path / "precious")
    (tmp_path / "left.zenoh").touch()
    assert orphaned_segments(tmp_path) == [tmp_path / "left.zenoh"]


def held_by(pid: int) -> set[Path]:
    """A process's own segments: others on the machine have theirs."""
    held = set()
    for file in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # it was closed meanwhile
            held.add(Path(os.readlink(file)))
    return {path for path in held if path.parent == Path("/dev/shm") and path.suffix == ".zenoh"}


def test_a_session_that_zenoh_gives_up_to_close_is_not_closed() -> None:
    class Unclosed:
        def close(self) -> None:
            raise zenoh.ZError("close operation timed out!")

    assert not close_session(cast(zenoh.Session, Unclosed()))  # that its thread ends by an error would be an error here


ENDING = """
from hierax.runtime.transport import zenoh_session
zenoh_session.CLOSE_TIMEOUT_S = 0.0
session = zenoh_session.open_session()
subscribers = [session.declare_subscriber("a/b", lambda sample: None) for _ in range(8)]
zenoh_session.close_session(session)
"""
"""Closes a session as late as one closes beside a stopped peer."""


def test_an_interpreter_that_ends_while_a_session_closes_is_not_aborted_by_its_threads() -> None:
    ended = [subprocess.Popen([sys.executable, "-c", ENDING], stderr=subprocess.PIPE, text=True) for _ in range(4)]
    assert [(each.communicate()[1], each.returncode) for each in ended] == [("", 0)] * len(ended)


@pytest.mark.parametrize(("address", "links"), [("127.0.0.1", True), ("10.9.8.7", False)])
def test_a_certificate_is_good_for_the_address_at_which_its_session_listens(address: str, links: bool) -> None:
    secret = new_secret(authority=True)
    endpoint = free_endpoint(None, secret)
    shown = encrypted(issued(secret, "launch", [address]))[ENCRYPTION]
    listener = open_session(
        [endpoint], zenoh_config={"transport": {"link": {"tls": shown}}}, secret=secret, role="launch"
    )
    settings = {"connect": {"timeout_ms": 1000}}
    try:
        if links:
            close_session(open_session((), [endpoint], settings, mode="client", secret=secret, role="reader"))
        else:
            with pytest.raises(TransportError, match="Unable to connect"):
                open_session((), [endpoint], settings, mode="client", secret=secret, role="reader")
    finally:
        close_session(listener)


def test_certificates_hold_whatever_a_clock_says() -> None:
    made = certificates(new_authority(), "launch", ["::1", "localhost"])
    for read in x509.load_pem_x509_certificates(made.encode()):
        assert (read.not_valid_before_utc.year, read.not_valid_after_utc.year) == (1970, 9999)


def test_an_authority_that_is_none_is_refused_in_one_line() -> None:
    whole = new_authority()
    for authority in ("some\n", whole[: len(whole) // 2], whole.replace("PRIVATE KEY", "CERTIFICATE")):
        with pytest.raises(TransportError, match="holds no certificate and private key that can be read"):
            open_session(secret=f"ab12\n{authority}")


def test_endpoints_say_how_links_are_and_where() -> None:
    assert endpoint_at() == "tcp/127.0.0.1:0"
    assert endpoint_at("10.0.0.1", "ab12", 7) == "tcp/10.0.0.1:7"
    assert endpoint_at("fe80::1", "ab12\nauthority", 7) == "tls/[fe80::1]:7"
    for address in ("0.0.0.0", "::"):
        with pytest.raises(TransportError, match="is no address that others could link to"):
            endpoint_at(address)
