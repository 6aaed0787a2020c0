"""The commands against running launches, as far as the launch is not needed: which one is meant, and what is said."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.deployments import line_of, write

from hierax.runtime.commands import membership as changes
from hierax.runtime.commands.main import main
from hierax.runtime.launch.run_file import Running, forget, known_runs, register
from hierax.runtime.transport import launch_client
from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.transport.port import TransportError
from hierax.schemas.access import OPERATOR
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

SNIPPET = """\
nodes:
  extra: {class: "support.toy_nodes:Summer", on_loss: detach, rejoin_timeout: 3}
edges:
  left -> extra: {sense: "support.toy_nodes:seen"}
"""
NODE = {"process": "ab", "pid": 77, "state": "running", "restarts": 2, "instance": 3, "host": ""}


class FakeLaunches:
    """What is asked of which endpoint; each answers as it is told to."""

    def __init__(self, folder: Path) -> None:
        self.file = write(folder)
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.answers: dict[str, Any] = {"change": {"epoch": 42}}
        self.silent: set[str] = set()
        self.after: Callable[[str, dict[str, Any]], None] = lambda endpoint, question: None

    def runs(self, run: str, endpoint: str, hierarchy: str = "toys") -> None:
        """A launch that this machine knows of."""
        register(Running(run, hierarchy, endpoint, os.getpid(), str(self.file), ()), "ab12")
        self.answers[endpoint] = {
            "hierarchy": hierarchy,
            "run": run,
            "file": str(self.file),
            "settings": ["step=5"],
            "epoch": 12,
            "roster": 4,
            "nodes": {"world": NODE, "left": {**NODE, "pid": None, "state": "elsewhere"}},
        }

    def client(
        self, endpoint: str, zenoh_config: None = None, keys: Keys | None = None, secret: str = ""
    ) -> FakeClient:
        """In the place of `LaunchClient`."""
        if endpoint in self.silent and not secret:
            raise TransportError(f"the launch at {endpoint} cannot be reached")
        return FakeClient(self, endpoint)


class FakeClient(LaunchClient):
    """Asks no launch, but those that a test has."""

    def __init__(self, launches: FakeLaunches, endpoint: str) -> None:
        self.endpoint = endpoint
        self._launches = launches
        self._keys = Keys("toys", "aaaa1111")
        self._role = OPERATOR

    def _get(self, key: str, question: Value, timeout_s: float) -> Iterator[tuple[str, Value]]:
        launches = self._launches
        launches.asked.append((self.endpoint, question))
        if self.endpoint in launches.silent:
            raise TransportError(f"the launch at {self.endpoint} does not answer")
        launches.after(self.endpoint, question)
        yield key, launches.answers[self.endpoint if question["ask"] == "ps" else question["ask"]]

    def close(self) -> None:
        return


@pytest.fixture
def launches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeLaunches:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    fake = FakeLaunches(tmp_path)
    monkeypatch.setattr(launch_client, "LaunchClient", fake.client)
    return fake


@pytest.fixture
def snippet(tmp_path: Path) -> str:
    return str(write(tmp_path, SNIPPET, "extra.yaml"))


def error(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line in which a command fails."""
    assert main(arguments) == 1
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    return line.removeprefix("error: ")


def test_without_a_launch_there_is_nothing_to_change(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], snippet: str
) -> None:
    for arguments in (["attach", snippet], ["detach", "left"], ["replace", "left", snippet], ["ps", "--run", "aa"]):
        assert "no launch" in error(capsys, *arguments)
    assert main(["ps"]) == 0
    assert capsys.readouterr().out == "no launch runs on this machine\n"
    assert main(["ps", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"runs": []}
    assert launches.asked == []


def test_waiting_for_a_launch_has_an_end(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(changes, "WAIT_S", 0.0)
    assert error(capsys, "ps", "--wait", "1") == "no launch has committed epoch 1 within 0 s"
    assert "no launch 'toys' runs" in error(capsys, "ps", "--wait", "1", "--run", "toys")
    assert launches.asked == []


def test_a_launch_that_is_over_since_it_was_listed_is_left_out(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    listed = [known_runs(), []]
    forget(listed[0][0].run)  # and with it its key
    monkeypatch.setattr(changes, "known_runs", lambda: listed.pop(0))
    assert main(["ps"]) == 0
    assert capsys.readouterr().out == "no launch runs on this machine\n"


@pytest.mark.parametrize("which", [(), ("--run", "toys"), ("--connect", "tcp/127.0.0.1:1")])
@pytest.mark.parametrize(
    ("wanted", "lacks"), [("99", "committed epoch 99"), ("top", "a node 'top'"), ("²", "a node '²'")]
)
def test_nobody_waits_for_a_launch_that_is_over(
    launches: FakeLaunches,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    which: tuple[str, ...],
    wanted: str,
    lacks: str,
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    assert main(["ps", *which, "--wait", "left"]) == main(["ps", *which, "--wait", "12"]) == 0
    capsys.readouterr()

    def ends(endpoint: str, question: dict[str, Any]) -> None:
        for file in (tmp_path / "hierax").glob("*.json"):
            file.unlink()
        launches.silent.add(endpoint)

    launches.after = ends
    assert error(capsys, "ps", *which, "--wait", wanted) == f"toys, run aaaa1111, is over; no launch has {lacks}"


def test_of_several_launches_one_has_to_be_named(launches: FakeLaunches, capsys: pytest.CaptureFixture[str]) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    launches.runs("bbbb2222", "tcp/127.0.0.1:2", "letters")
    said = error(capsys, "detach", "left")
    assert said == "several launches run on this machine, say which with --run: aaaa1111 (toys), bbbb2222 (letters)"
    assert "did you mean 'aaaa1111'?" in error(capsys, "detach", "left", "--run", "aaaa1112")
    assert "did you mean 'letters'?" in error(capsys, "detach", "left", "--run", "leters")
    assert launches.asked == []
    for named in ("bbbb2222", "bbb", "letters"):
        assert main(["detach", "left", "--run", named]) == 0
        assert capsys.readouterr().out == "detached left at epoch 42\n"
        assert launches.asked.pop()[0] == "tcp/127.0.0.1:2"


def test_a_name_that_fits_several_launches_is_refused_with_all_of_them(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str]
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    launches.runs("aabb2222", "tcp/127.0.0.1:2")
    launches.runs("aacc3333", "tcp/127.0.0.1:3", "letters")
    for named, listed in (
        ("toys", "aaaa1111 (toys), aabb2222 (toys)"),
        ("aa", "aaaa1111 (toys), aabb2222 (toys), aacc3333 (letters)"),
    ):
        said = error(capsys, "detach", "left", "--run", named)
        assert said == f"several launches of {named!r} run on this machine, say which with --run: {listed}"
    assert launches.asked == []


def test_an_attach_sends_the_snippet_and_what_it_says_about_losses(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], snippet: str
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    assert main(["attach", snippet]) == 0
    assert capsys.readouterr().out == "attached extra at epoch 42\n"
    _, question = launches.asked[-1]
    assert question["change"]["change"] == "attach"
    assert list(question["change"]["nodes"]) == ["extra"]
    assert question["terms"]["extra"]["on_loss"] == "detach"
    assert question["terms"]["extra"]["rejoin_timeout_s"] == 3
    assert not question["here"]


def test_a_node_of_the_deployment_is_attached_by_name_with_the_settings_of_the_launch(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str]
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    assert main(["attach", "left", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"epoch": 42}
    change = launches.asked[-1][1]["change"]
    assert [(edge["lower"], edge["upper"]) for edge in change["edges"]] == [("left", "top.most"), ("world", "left")]


def test_secret_settings_of_the_launch_are_not_needed_to_change_it(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str]
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    launches.answers["tcp/127.0.0.1:1"]["settings"] = ["step=5", "zenoh.transport.auth.usrpwd.password"]
    assert main(["attach", "left"]) == 0
    assert capsys.readouterr().out == "attached left at epoch 42\n"


def test_what_is_refused_of_a_snippet_is_told_with_its_place_there(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], snippet: str
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    what = "nodes.extra.class: there is no 'Summer'"
    for refusal in (f"extra: {what}", what):  # by its process, or by the launch
        launches.answers["change"] = {"refusal": refusal}
        assert error(capsys, "attach", snippet) == f"{snippet}:2: {what}"
    function = "edges.left -> extra.sense: there is no 'sen'"
    launches.answers["change"] = {"refusal": f"left: {function}"}  # in whose process it runs
    assert error(capsys, "attach", snippet) == f"{snippet}:4: {function}"
    launches.answers["change"] = {"refusal": "left: nodes.left.class: no"}
    assert error(capsys, "attach", "left") == f"{launches.file}:{line_of('left: {class')}: nodes.left.class: no"
    launches.answers["change"] = {"refusal": "extra: observe in epoch 3: KeyError: 'n'"}
    assert error(capsys, "attach", snippet) == "extra: observe in epoch 3: KeyError: 'n'"


def test_what_the_launch_refuses_is_the_commands_error(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str]
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    launches.answers["change"] = {"refusal": "cannot detach 'left': no"}
    assert error(capsys, "detach", "left") == "cannot detach 'left': no"
    launches.answers["change"] = "what?"
    assert "gave an answer that is no map" in error(capsys, "detach", "left")


def test_a_replacement_with_another_name_is_refused_before_the_launch_is_asked(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], snippet: str
) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    assert "expected no other node than the one to be replaced, 'left'" in error(capsys, "replace", "left", snippet)
    assert [question["ask"] for _, question in launches.asked] == ["ps"]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--connect", "10.0.0.1:7000"], "--connect: expected an endpoint such as tls/192.168.1.2:40123"),
        (["--host", "10.0.0.2"], "--host: only with --here"),
        (["--here", "--connect", "tcp/10.0.0.1:7000"], "give this machine's address by --host"),
    ],
)
def test_wrong_options_for_other_machines(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], snippet: str, options: list[str], what: str
) -> None:
    assert what in error(capsys, "attach", snippet, *options)
    assert launches.asked == []


def test_ps_lists_all_launches(launches: FakeLaunches, capsys: pytest.CaptureFixture[str]) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    launches.runs("bbbb2222", "tcp/127.0.0.1:2", "letters")
    assert main(["ps"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "toys, run aaaa1111: epoch 12, roster version 4"
    assert lines[1].split() == ["node", "state", "pid", "instance", "restarts"]
    assert lines[3].split() == ["world", "running", "77", "3", "2"]
    assert lines[4].split() == ["left", "elsewhere", "3", "2"]
    assert lines[5:7] == ["", "letters, run bbbb2222: epoch 12, roster version 4"]
    assert main(["ps", "--run", "bbbb2222", "--format", "json"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert (run["hierarchy"], run["nodes"]["world"]) == ("letters", NODE)


def test_ps_tells_hosts_where_there_are_several(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(NODE, "host", "robot")
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    assert main(["ps"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["node", "state", "host", "pid", "instance", "restarts"]
    assert lines[3].split() == ["world", "running", "robot", "77", "3", "2"]


def test_ps_tells_of_a_launch_that_does_not_answer(launches: FakeLaunches, capsys: pytest.CaptureFixture[str]) -> None:
    launches.runs("aaaa1111", "tcp/127.0.0.1:1")
    launches.runs("bbbb2222", "tcp/127.0.0.1:2", "letters")
    launches.silent.add("tcp/127.0.0.1:1")
    assert main(["ps"]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("letters, run bbbb2222")
    assert said.err == f"error: no answer from aaaa1111 (toys, process {os.getpid()})\n"


def test_what_a_dead_launch_left_behind_is_no_launch(
    launches: FakeLaunches, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = register(Running("dead0000", "toys", "tcp/127.0.0.1:1", 2**22 - 1, str(launches.file), ()))
    (path.parent / "torn.json").write_text('{"run": ')
    assert main(["ps"]) == 0
    assert capsys.readouterr().out == "no launch runs on this machine\n"
    assert not path.exists()
