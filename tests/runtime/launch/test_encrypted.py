"""Launches that other machines may join: links are encrypted, and whoever shows no certificate of the run has none."""

import os
import signal
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
from support.attacks import doors_of, ports_of
from support.launched import processes_of
from support.live import Live, hierax
from support.relay import Relay

from hierax.runtime.host.run_secret import certificates_of, new_secret, token_of
from hierax.runtime.launch.run_file import warning_of
from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import address_of

QUICKLY = {"connect": {"timeout_ms": 500}}


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path, "--host", "127.0.0.1", "--record", str(tmp_path / "live.mcap"))
    yield launch
    launch.close()


def heard_on_the_way(live: Live) -> bytes:
    """What passes while somebody asks a launch how it is."""
    address, port = address_of(live.endpoint)
    relay = Relay(port)
    try:
        with LaunchClient(
            live.endpoint.replace(f"{address}:{port}", f"127.0.0.1:{relay.port}"), secret=live.secret
        ) as client:
            assert client.status().run == live.run["run"]
        return bytes(relay.passed)
    finally:
        relay.close()


def is_let_in(endpoint: str, secret: str) -> bool:
    try:
        LaunchClient(endpoint, QUICKLY, secret=secret).close()
    except TransportError:
        return False
    return True


def test_nothing_can_be_read_on_the_way_and_the_run_is_what_it_was(live: Live, tmp_path: Path) -> None:
    assert live.endpoint.startswith("tls/127.0.0.1:")
    run = live.run["run"]
    passed = heard_on_the_way(live)
    assert len(passed) > 1000
    assert run.encode() not in passed
    live.goes_on()
    live.is_repeated_by()
    said = hierax(tmp_path, "replay", str(tmp_path / "live.mcap"), "--verify")
    assert (said.returncode, "all results are alike" in said.stdout) == (0, True), said.stderr


def test_nodes_are_attached_from_elsewhere_and_killed(live: Live, tmp_path: Path) -> None:
    key = live.brought_key(tmp_path / "elsewhere")
    path = live.snippet("top", "high")
    where = ("--connect", live.endpoint, "--key", str(key), "--here", "--host", "127.0.0.1")
    keeper = live.start("attach", path, *where, "--deployment", str(live.file))
    epoch = int(keeper.says("attached top at epoch").split()[-1])
    live.goes_on()
    for pid in (live.run["nodes"]["low"]["pid"], *processes_of(keeper.process.pid)):
        os.kill(pid, signal.SIGKILL)
        live.goes_on()
    live.is_repeated_by(f"{epoch}:attach:{path}")


def test_who_shows_no_certificate_of_the_run_is_let_in_at_no_port_and_told(live: Live) -> None:
    secret, other = live.secret, new_secret(authority=True)
    token, authority = token_of(secret), certificates_of(secret)
    assert authority
    wrong = {
        "no key": "",
        "the token alone": token,
        "another run's": other,
        "another authority": f"{token}\n{certificates_of(other)}",
        "another token": f"{token_of(other)}\n{authority}",
    }
    run = live.run
    pids = [live.launch.process.pid, *(node["pid"] for node in run["nodes"].values())]
    endpoints = ports_of(pids)
    assert not doors_of(pids)  # which ask for no certificate
    assert len(endpoints) > len(run["nodes"])
    for endpoint, scheme, (what, each) in product(endpoints, ("tls", "tcp"), wrong.items()):
        assert not is_let_in(f"{scheme}{endpoint.removeprefix('tcp')}", each), (what, scheme)
    live.launch.says("refused somebody: it has no certificate of this run")
    live.launch.says("it has no key of this run")
    live.goes_on()
    live.is_repeated_by()
    assert not any("zenoh" in line.lower() for line in live.launch.err), live.launch.err


def test_insecure_leaves_links_as_they_were(tmp_path: Path) -> None:
    plain = Live(tmp_path, "--host", "127.0.0.1", "--set", "insecure=true")
    try:
        assert plain.endpoint.startswith("tcp/")
        assert not certificates_of(plain.secret)
        assert plain.run["run"].encode() in heard_on_the_way(plain)
    finally:
        plain.close()


def test_a_name_will_do_for_an_address_and_one_of_all_addresses_will_not(tmp_path: Path) -> None:
    named = Live(tmp_path, "--host", "localhost")
    try:
        assert named.endpoint.startswith("tls/localhost:")
        named.goes_on()
        named.is_repeated_by()
    finally:
        named.close()
    said = hierax(tmp_path, "launch", str(named.file), "--host", "0.0.0.0")
    told = "error: 0.0.0.0 is no address that others could link to; expected one of this machine's\n"
    assert (said.returncode, said.stderr) == (1, told)


def test_what_is_not_protected_is_told() -> None:
    assert (
        warning_of("tcp/127.0.0.1:7", "")
        == "open: true: anybody who reaches tcp/127.0.0.1:7 may read and change this run"
    )
    told = "insecure: true: what is said to and from tcp/10.0.0.1:7 passes between machines unencrypted"
    assert warning_of("tcp/10.0.0.1:7", "secret") == told
    assert {warning_of(endpoint, "secret") for endpoint in ("tcp/127.0.0.1:7", "tls/10.0.0.1:7")} == {""}
