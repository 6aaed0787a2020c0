"""Keepers behind a stand-in for `ssh`, which runs what it is told on this machine, so that nobody need be root."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.far_hosts import script
from support.live import TESTS, Live, until

from hierax.runtime.deployment.deployment import Host
from hierax.runtime.host.installed import installed_digest
from hierax.runtime.launch.keeper_link import Greeting, HostError, KeeperLink, ssh_command

STAND_IN = ('for word; do last="$word"; done', 'export SSH_CONNECTION="127.0.0.1 1 127.0.0.1 22"', 'exec sh -c "$last"')


@pytest.fixture(autouse=True)
def ssh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bin").mkdir()
    script(tmp_path / "bin" / "ssh", STAND_IN)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    hosts = f"hosts: {{robot: {{ssh: robot, python: {sys.executable}, folder: {TESTS}}}}}\n"
    live = Live(tmp_path, pace_s=0.01, more=hosts + "place: {world: robot, low: robot}\n")
    yield live
    live.close()


def keepers(live: Live) -> list[int]:
    """The processes that a launch has started which are keepers."""
    threads = Path(f"/proc/{live.launch.process.pid}/task").glob("*/children")
    started = [int(pid) for thread in threads for pid in thread.read_text().split()]
    return [pid for pid in started if b"hierax.runtime.launch.keeper" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_a_keeper_that_dies_is_started_again_and_its_nodes_go_on(live: Live) -> None:
    live.goes_on()
    (keeper,) = keepers(live)
    os.kill(keeper, 9)
    live.launch.says("host robot is there again")
    live.goes_on()
    nodes = live.run["nodes"]
    assert {name: (node["host"], node["restarts"]) for name, node in nodes.items()} == {
        "world": ("robot", 1),
        "low": ("robot", 1),
        "high": ("", 0),
    }
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"])["digest"]


def test_a_process_there_that_is_killed_is_started_again_there(live: Live) -> None:
    live.goes_on()
    os.kill(live.run["nodes"]["low"]["pid"], 9)
    live.launch.says("low: its process ended by signal SIGKILL; it is started again")
    live.goes_on()
    assert live.run["nodes"]["low"]["host"] == "robot"
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"])["digest"]


def test_a_node_there_is_replaced_detached_and_attached_again_there(live: Live) -> None:
    live.goes_on()
    anew = live.snippet("low", generation=1)
    replaced = live.change("replace", "low", anew)
    live.goes_on()
    assert live.run["nodes"]["low"]["host"] == "robot"
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"], f"{replaced}:replace:low:{anew}")["digest"]


def test_the_run_has_no_secret_in_arguments_or_environment(live: Live) -> None:
    secret = live.secret.partition("\n")[0]
    assert secret
    pids = [*keepers(live), *(node["pid"] for node in live.run["nodes"].values())]
    for pid in pids:
        for what in ("cmdline", "environ"):
            assert secret.encode() not in Path(f"/proc/{pid}/{what}").read_bytes()


def test_a_keeper_says_who_it_is_and_ends_with_its_pipe() -> None:
    link = KeeperLink(Host("robot", ("robot",), sys.executable))
    greeting = link.greeting()
    assert greeting == Greeting(greeting.version, installed_digest(), "127.0.0.1", "127.0.0.1")
    link.hang_up()
    until(lambda: link.process.poll() is not None, "the end of the keeper")
    assert link.process.returncode == 0
    link.close()


def test_what_a_shell_says_first_is_passed_over(tmp_path: Path) -> None:
    chatty = script(tmp_path / "chatty", ["echo welcome", "seq 1 5000", f'exec {sys.executable} "$@"'])
    link = KeeperLink(Host("robot", ("robot",), chatty))
    assert link.greeting().digest == installed_digest()
    link.close()


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["exit 3"], "there ended with exit code 3; expected it to run the keeper"),
        (["echo what >&2", "exit 1"], "there ended with exit code 1: what; expected it to run the keeper"),
        (["yes"], "it says b'y\\ny\\n"),
    ],
)
def test_what_is_no_python_is_told(tmp_path: Path, lines: list[str], what: str) -> None:
    link = KeeperLink(Host("robot", ("robot",), script(tmp_path / "none", lines)))
    with pytest.raises(HostError, match=r"hosts\.robot") as raised:
        link.greeting()
    assert what in str(raised.value)
    link.close(0.0)


def test_no_ssh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(HostError, match=r"hosts\.robot: `ssh` cannot be started here: No such file or directory"):
        KeeperLink(Host("robot", ("robot",)))


def test_the_users_words_come_first_and_paths_are_the_hosts() -> None:
    host = Host("robot", ("-p", "2222", "pi@robot"), "~/my venv/bin/python", folder="~/a b")
    *words, command = ssh_command(host)
    assert words[:4] == ["ssh", "-p", "2222", "-T"]
    assert words[-2:] == ["--", "pi@robot"]
    assert "BatchMode=yes" in words
    assert command.startswith("cd ~/'a b' && exec ~/'my venv'/bin/python -c ")
    assert shlex.split(command)[-1] == "hierax.runtime.launch.keeper"
