"""Who has no key of a run is not let into it: neither hears nor says anything there, whoever it is."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.attacks import Outcome, attacked, order_for
from support.live import Live, environment, hierax, until

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_folder import run_folder
from hierax.runtime.host.run_secret import key_text, new_secret, read_key
from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.transport.port import TransportError

QUICKLY = {"connect": {"timeout_ms": 500}}


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path, "--state", str(tmp_path / "state"), "--record", str(tmp_path / "live.mcap"))
    yield launch
    launch.close()


def attack(live: Live, secrets: dict[str, str | None], folder: Path) -> Outcome:
    """What comes of attacks on a launch by who has these secrets."""
    return attacked(order_for(live, secrets, messages=2000, size=8 << 20), folder)


def test_who_has_no_key_of_the_run_neither_hears_nor_says_anything(live: Live, tmp_path: Path) -> None:
    earlier = tmp_path / "earlier"
    earlier.mkdir()
    other = Live(earlier)
    try:
        secrets = {"no key": None, "a wrong key": new_secret(), "another run's key": other.secret}
        old = attack(live, secrets, tmp_path)
    finally:
        other.close()
    old |= attack(live, {"the key of a run that is over": secrets["another run's key"]}, tmp_path)
    came = {(who, what): count for who, each in old.items() for what, count in each.items() if count}
    assert not came, came
    assert len([what for each in old.values() for what in each]) > 40
    live.goes_on()
    live.is_repeated_by()


def test_who_has_the_key_is_let_in_and_so_is_anybody_where_the_run_is_open(live: Live, tmp_path: Path) -> None:
    inside = attack(live, {"its key": live.secret}, tmp_path)["its key, peer"]
    assert all(inside[what] for what in ("links", "samples heard", "tokens heard", "answers to ps", "liveliness seen"))
    folder = tmp_path / "open"
    folder.mkdir()
    opened = Live(folder, "--set", "open=true")
    try:
        assert any("open: true: anybody who reaches" in line for line in opened.launch.err)
        assert not list((folder / "hierax").glob("*.key"))
        said = hierax(folder, "ps", "--format", "json")
        assert said.returncode == 0
        told = f"hierax: open: true: anybody who reaches {opened.endpoint} may read and change this run\n"
        assert said.stderr == told
        with LaunchClient(opened.endpoint) as client:
            assert client.status().run == json.loads(said.stdout)["runs"][0]["run"]
    finally:
        opened.close()


def test_the_secret_stands_in_its_key_alone(live: Live, tmp_path: Path) -> None:
    secret, run = live.secret, live.run
    assert live.key.stat().st_mode & 0o777 == 0o600
    assert live.key.parent.stat().st_mode & 0o777 == 0o700
    live.goes_on()
    pids = [live.launch.process.pid, *(node["pid"] for node in run["nodes"].values())]
    for pid in pids:
        for what in ("cmdline", "environ"):
            assert secret.encode() not in Path(f"/proc/{pid}/{what}").read_bytes(), (pid, what)
    assert secret not in hierax(tmp_path, "ps", "--format", "json").stdout
    live.ends()
    left = [path for folder in (tmp_path, run_folder(run["run"])) for path in folder.rglob("*") if path.is_file()]
    assert {"run.json", "live.mcap", "about.json"} <= {path.name for path in left}
    assert [path for path in left if secret.encode() in path.read_bytes()] == []
    assert not live_keys(tmp_path)


def live_keys(folder: Path) -> list[Path]:
    return list((folder / "hierax").glob("*.key"))


def test_from_elsewhere_a_copy_of_the_key_lets_in(live: Live, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    key = live.brought_key(elsewhere)
    said = hierax(elsewhere, "ps", "--connect", live.endpoint, "--key", str(key), "--format", "json")
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout)["runs"][0]["run"] == live.run["run"]
    assert said.stderr == ""
    with pytest.raises(TransportError, match="takes only who has its key"):
        LaunchClient(live.endpoint, QUICKLY)
    with pytest.raises(TransportError, match="does not take this key: it is that of another run"):
        LaunchClient(live.endpoint, QUICKLY, secret=new_secret())
    key.chmod(0o644)
    said = hierax(elsewhere, "ps", "--connect", live.endpoint, "--key", str(key))
    assert said.returncode == 1
    assert said.stderr == f"error: {key}: others may read it (mode 0644); expected a key for you alone: chmod 600\n"
    said = hierax(elsewhere, "ps", "--key", str(key))
    assert said.stderr == "error: --key: only with --connect; of a launch on this machine it is found\n"


def test_what_is_no_key_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "some.key"
    with pytest.raises(HieraxError, match="cannot be read: No such file"):
        read_key(path)
    whole = key_text(new_secret(authority=True))
    half = whole[: len(whole) // 2]
    for content in (b"", b"hierax:", b"otto:abc\n", b"hierax:a b\n", b"\xff\x00" * 9, b"hierax:ab12\nmore\n", half):
        path.write_bytes(content)
        path.chmod(0o600)
        with pytest.raises(HieraxError, match="expected the key of a run, a line 'hierax:"):
            read_key(path)
    for secret in ("ab12", new_secret(authority=True)):
        path.write_bytes(key_text(secret))
        assert read_key(path) == secret


def test_a_run_that_is_resumed_has_another_key(live: Live, tmp_path: Path) -> None:
    before = live.secret
    live.launch.kill()
    again = live.start("launch", "--resume", str(tmp_path / "state"), "--format", "json")
    until(lambda: live_keys(tmp_path), "the run's key")
    assert live.secret != before
    until(lambda: hierax(tmp_path, "ps").stdout, "the launch")
    (tmp_path / "stop").touch()
    assert again.ends() == 0, again.err
    assert environment(tmp_path)["XDG_RUNTIME_DIR"] == str(tmp_path)


def test_who_was_refused_is_told_with_the_address_in_few_lines(live: Live) -> None:
    for _ in range(5):
        with pytest.raises(TransportError):
            LaunchClient(live.endpoint, QUICKLY)
    live.launch.says("refused 127.0.0.1:")
    live.launch.says("it has no key of this run (4 times by now)")
    live.ends()
    told = [line for line in live.launch.err if "refused 127.0.0.1:" in line]
    assert 3 <= len(told) < 8, told
    assert not any("zenoh" in line for line in live.launch.err), live.launch.err


def test_who_changed_what_is_written_down_for_its_user_alone(live: Live, tmp_path: Path) -> None:
    path = live.snippet("top", "high")
    epoch = live.change("attach", path)
    assert live.hierax("attach", path).returncode == 1
    live.change("detach", "top")
    assert live.hierax("detach", "nobody").returncode == 1
    with LaunchClient(live.endpoint, secret=live.secret) as client:
        for odd in (
            {"change": 7},
            {"change": {"change": "detach", "name": "low", "cascade": False}, "by": "a\x1b[2Jb"},
        ):
            with pytest.raises(HieraxError):
                client.ask({"ask": "change", **odd})
    attack(live, {"a wrong key": new_secret()}, tmp_path)
    for who in ("hierax: ", "hierax: world: ", "hierax: low: ", "hierax: high: "):
        until(
            lambda who=who: any(line.startswith(f"{who}refused ") for line in live.launch.err), f"{who}who was refused"
        )
    file = run_folder(live.run["run"]) / "logs" / "_audit.jsonl"
    assert file.stat().st_mode & 0o777 == 0o600
    told = until(lambda: [line for line in audited(live) if "no key of this run" in line["message"]], "who was refused")
    assert told[0]["outcome"] == "refused"
    changes = [line for line in audited(live) if "by" in line]
    outcomes = [(line.get("change"), line.get("nodes"), line["outcome"].partition(":")[0]) for line in changes]
    assert outcomes[:2] == [("attach", "top", f"at epoch {epoch}"), ("attach", "top", "refused")]
    assert [each[:2] for each in outcomes[2:]] == [
        ("detach", "top"),
        ("detach", "nobody"),
        (None, None),
        ("detach", "low"),
    ]
    assert {each[2] for each in outcomes[3:]} == {"refused"}
    assert changes[0]["by"].startswith(f"user {os.getuid()} on ")
    assert {each["with"] for each in changes} == {"the key of the run"}
    assert changes[0]["details"]["nodes"]["top"]
    assert changes[-1]["by"] == "somebody who does not say who it is"
    assert "\x1b" not in file.read_text(encoding="utf-8")
    assert not any(line["logger"] == "hierax.audit" for line in logged(live))
    live.ends()
    assert audited(live)[-1]["message"] == "the run is over"


def logged(live: Live, *arguments: str) -> list[dict[str, Any]]:
    said = live.hierax("logs", "--format", "json", *arguments)
    return [json.loads(line) for line in said.stdout.splitlines()]


def audited(live: Live) -> list[dict[str, Any]]:
    return logged(live, "--audit")
