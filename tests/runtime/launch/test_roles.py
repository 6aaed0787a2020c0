"""Who has which key of a launch, or another node's certificate, may do what its role says, and no more."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.launched import processes_of
from support.live import EDGE, NODE, Live, hierax, until
from support.role_attacks import RoleAttack

from hierax.runtime.host.run_secret import issued, may_issue, read_key, whose
from hierax.runtime.transport.access_control import launch_alone
from hierax.runtime.transport.launch_client import AnswerError, LaunchClient
from hierax.runtime.transport.zenoh_session import close_session, open_session
from hierax.schemas.access import OPERATOR, READER
from hierax.schemas.roster import Detach

REFUSED = "error: the key is a reader's, who looks and changes nothing; expected an operator's\n"


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path, "--host", "127.0.0.1")
    yield launch
    launch.close()


class Elsewhere:
    """Another machine, with one key of a launch."""

    def __init__(self, live: Live, *options: str) -> None:
        self.folder = live.folder / "elsewhere"
        self.folder.mkdir()
        self.key = self.folder / "some.key"
        made = live.hierax("keys", str(self.key), *options)
        assert made.returncode == 0, made.stderr
        self.reaches = ("--connect", live.endpoint, "--key", str(self.key))

    def says(self, *arguments: str) -> tuple[int, str, str]:
        """What a command says there."""
        done = hierax(self.folder, *arguments, *self.reaches)
        return done.returncode, done.stdout, done.stderr


def test_a_reader_sees_all_and_changes_nothing(live: Live) -> None:
    elsewhere, file = Elsewhere(live), str(live.folder / "heard.mcap")
    code, out, _ = elsewhere.says("ps", "--format", "json")
    assert (code, json.loads(out)["runs"][0]["run"]) == (0, live.run["run"])
    for looks in (("inspect", "low"), ("echo", "obs/world/low", "--count", "2"), ("top", "--once"), ("health",)):
        code, out, err = elsewhere.says(*looks)
        assert (code, bool(out), err) == (0, True, ""), looks
    code, out, err = elsewhere.says("record", "-o", file, "--epochs", "20")
    assert (code, "20 epochs" in out) == (0, True), err
    assert hierax(live.folder, "replay", file, "--verify").returncode == 0
    path, own = live.snippet("top", "high"), ("--deployment", str(live.file))
    other = live.snippet("high", generation=1)
    for changes in (("detach", "high"), ("attach", path, *own), ("replace", "high", other, *own)):
        assert elsewhere.says(*changes) == (1, "", REFUSED), changes
    assert elsewhere.says("set", "high.generation=3") == (1, "", REFUSED)
    live.is_repeated_by()


def test_an_operator_changes_the_launch_also_with_nodes_that_it_keeps(live: Live) -> None:
    elsewhere, path = Elsewhere(live, "--role", "operator", "--expires", "1h"), live.snippet("top", "high")
    own = ("--deployment", str(live.file))
    code, out, err = elsewhere.says("attach", path, *own, "--format", "json")
    assert code == 0, err
    first = json.loads(out)["epoch"]
    beside = live.snippet("beside", "top")
    keeper = live.start("attach", beside, *own, *elsewhere.reaches, "--here", "--host", "127.0.0.1")
    second = int(keeper.says("attached beside at epoch").split()[-1])
    live.goes_on()
    os.kill(processes_of(keeper.process.pid)[0], signal.SIGKILL)
    live.goes_on()
    code, out, err = elsewhere.says("detach", "beside", "--format", "json")
    assert code == 0, err
    third = json.loads(out)["epoch"]
    assert keeper.ends() == 0, keeper.err
    code, _, err = elsewhere.says("keys", str(elsewhere.folder / "more.key"))
    assert code == 1
    assert err.startswith("error: the key is one role's; others are made by the key of the run")
    audited = [json.loads(line) for line in live.hierax("logs", "--audit", "--format", "json").stdout.splitlines()]
    assert [line["with"] for line in audited if "by" in line] == ["an operator's certificate"] * 3
    live.is_repeated_by(f"{first}:attach:{path}", f"{second}:attach:{beside}", f"{third}:detach:beside")


def test_what_a_role_may_not_comes_to_nothing(live: Live) -> None:
    attack = RoleAttack(live)
    try:
        outcome = attack.all()
    finally:
        attack.close()
    assert len(outcome) == 8
    came = {(who, what): count for who, each in outcome.items() for what, count in each.items() if count}
    assert not came, came
    live.goes_on()
    live.is_repeated_by()
    for who, tried in NAMED.items():
        for each in tried:
            said = f"hierax: refused the certificate of {who}: it may not {each} on hierax/live/"
            assert any(line.startswith(said) for line in live.launch.err), said


FORGES = ("put", "delete", "offer answers", "claim to live")
NAMED = {
    "a reader": (*FORGES, "ask"),
    "an operator": FORGES,
    "a later node": (*FORGES, "ask", "listen"),
    "node high": (*FORGES, "ask", "listen"),
}


def test_who_is_not_held_to_the_list_would_hear_what_is_forged(live: Live) -> None:
    attack = RoleAttack(live, listed=False)
    try:
        came = dict(attack.by(READER, "peer"))
        [flooded] = attack.flood(READER, "peer", 100, 0).values()
    finally:
        attack.close()
    assert all(came[what] for what in ("answers that are forged", "puts and deletes heard", "tokens seen")), came
    assert flooded
    live.is_repeated_by()


def test_a_key_is_good_for_its_time_and_ends_links_that_it_has(live: Live) -> None:
    elsewhere = Elsewhere(live, "--expires", "4s")
    secret = read_key(elsewhere.key)
    assert not may_issue(secret)
    role, when = whose(secret) or ("", None)
    assert (role, when is not None) == (READER, True)
    session = open_session((), [live.endpoint], None, False, "client", secret=secret, access=launch_alone())
    assert list(session.info.peers_zid())
    until(lambda: not list(session.info.peers_zid()), "the end of the link")
    close_session(session)
    code, _, err = elsewhere.says("ps")
    assert (code, "; this key was good until 20" in err) == (1, True), err
    live.launch.says("refused somebody: its certificate has ended")
    assert not any("no certificate of this run" in line for line in live.launch.err), live.launch.err
    live.goes_on()


def test_nodes_that_share_a_process_have_one_certificate_and_those_of_later_speak_to_one_another(
    tmp_path: Path,
) -> None:
    live = Live(tmp_path, "--host", "127.0.0.1", "--processes", "2")
    try:
        path = tmp_path / "two.yaml"
        edges = "".join(EDGE.format(lower=low, name=name).removeprefix("edges:\n") for low, name in PAIRS)
        nodes = "".join(NODE.format(name=name, generation=0, policy="").removeprefix("nodes:\n") for _, name in PAIRS)
        path.write_text(f"nodes:\n{nodes}edges:\n{edges}", encoding="utf-8")
        epoch = live.change("attach", str(path))
        live.goes_on()
        for name in ("low", "second"):
            os.kill(live.run["nodes"][name]["pid"], signal.SIGKILL)
            live.goes_on()
        live.is_repeated_by(f"{epoch}:attach:{path}")
    finally:
        live.close()


PAIRS = (("high", "first"), ("first", "second"))


def test_without_certificates_there_are_no_roles(tmp_path: Path) -> None:
    live = Live(tmp_path)
    try:
        said = live.hierax("keys", str(tmp_path / "some.key"))
        assert said.returncode == 1
        told = f"error: the launch at {live.endpoint} has no certificates, so no roles; launch it with --host\n"
        assert said.stderr == told
    finally:
        live.close()


def test_keys_are_for_one_alone_and_replace_nothing(live: Live) -> None:
    elsewhere = Elsewhere(live)
    assert elsewhere.key.stat().st_mode & 0o777 == 0o600
    again = live.hierax("keys", str(elsewhere.key))
    assert (again.returncode, again.stderr) == (1, f"error: {elsewhere.key}: cannot be written: File exists\n")
    far = live.hierax("keys", str(elsewhere.folder / "far.key"), "--expires", "999d")
    assert (far.returncode, far.stderr) == (1, "error: --expires 999d: expected a year at most\n")
    told = live.hierax("keys", str(elsewhere.folder / "o.key"), "--role", "operator", "--format", "json")
    assert (json.loads(told.stdout)["role"], json.loads(told.stdout)["endpoint"]) == (OPERATOR, live.endpoint)


def test_a_client_in_python_is_told_as_well(live: Live) -> None:
    with LaunchClient(live.endpoint, secret=issued(live.secret, READER)) as client:
        assert client.status().run == live.run["run"]
        with pytest.raises(AnswerError, match="the key is a reader's"):
            client.change(Detach("high", cascade=False), {})
