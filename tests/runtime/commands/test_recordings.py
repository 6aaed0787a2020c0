"""`record`, `replay`, `diff` and `check` on the command line: what they print, and their exit codes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT, FLAW

from hierax.runtime.commands.main import main
from hierax.runtime.commands.recordings import print_comparison
from hierax.runtime.recording.diff import Comparison, Difference, RosterDifference


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With a deployment file and a recording of it; no launch runs here."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    Path("flawed.yaml").write_text(DEPLOYMENT, encoding="utf-8")
    assert main(["run", "flawed.yaml", "--record", "a.mcap", "--check", "--format", "json"]) == 0
    return tmp_path


Capture = pytest.CaptureFixture[str]


def said(capsys: Capture) -> str:
    return capsys.readouterr().out


def test_a_replay_reports_and_verifies(folder: Path, capsys: Capture) -> None:
    said(capsys)
    assert main(["run", "flawed.yaml", "--format", "json"]) == 0
    digest = json.loads(said(capsys))["digest"]
    assert main(["replay", "a.mcap", "--verify", "--format", "json"]) == 0
    report = json.loads(said(capsys))
    assert (report["mode"], report["epochs"], report["digest"]) == ("replay", 12, digest)
    assert report["nodes"].keys() == {"low", "high"}
    assert report["verify"] == {
        "alike": True,
        "epochs": 12,
        "equal": 12,
        "digests": 12,
        "not_told": 0,
        "rosters": [],
        "difference": None,
    }
    assert main(["replay", "a.mcap", "--node", "low", "--from", "3", "--to", "8", "--verify"]) == 0
    assert said(capsys).endswith("6 epochs, 6 digests: all results are alike\n")


def test_a_replay_with_other_parameters_says_where_it_departs(folder: Path, capsys: Capture) -> None:
    said(capsys)
    assert main(["replay", "a.mcap", "--set", "gain=1.0", "--verify"]) == 1
    out = said(capsys)
    assert "rosters differ from epoch 1: nodes.low.parameters.gain\n  recorded  0.5\n  replayed  1.0\n" in out
    assert "first difference: epoch 1, low, observe: belief.level\n" in out
    assert main(["replay", "a.mcap", "--set", "gain=1.0"]) == 0
    assert main(["replay", "a.mcap", "--with", "high=support.toy_nodes:Nothing"]) == 1
    assert "there is no 'Nothing' in module 'support.toy_nodes'" in capsys.readouterr().err


def test_a_replay_lists_what_would_have_been_decided_otherwise(
    folder: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    said(capsys)
    assert main(["replay", "a.mcap", "--decisions"]) == 0
    assert "low: the same in 12 of 12 epochs, something else in 0\n" in said(capsys)
    monkeypatch.setenv(FLAW, "high/policy/7")
    assert main(["replay", "a.mcap", "--node", "high", "--decisions"]) == 0
    out = said(capsys)
    assert "high: the same in 11 of 12 epochs, something else in 1\n" in out
    assert re.search(r"^high +7 +7 +\{by: 0\} +\{by: 7\}", out, re.MULTILINE), out
    assert main(["replay", "a.mcap", "--node", "high", "--decisions", "--format", "json"]) == 0
    high = json.loads(said(capsys))["decisions"]["high"]
    assert (high["epochs"], high["otherwise"]) == (12, 1)
    assert [(each["from"], each["to"]) for each in high["stretches"]] == [(7, 7)]
    assert high["stretches"][0]["replayed"]["actions"] == [{"by": 7.0}]
    assert main(["replay", "a.mcap", "--decisions", "--verify"]) == 1
    assert "--verify or --decisions, not both" in capsys.readouterr().err


def test_a_replay_is_of_one_node_alone_or_of_all(folder: Path, capsys: Capture) -> None:
    said(capsys)
    assert main(["replay", "a.mcap", "--node", "low", "--node", "high"]) == 2
    assert capsys.readouterr().err == "error: --node low --node high: expected one node, which is done again alone\n"


@pytest.mark.parametrize(
    ("arguments", "code", "what"),
    [
        (["--with", "low=a:A", "--with", "low=a:B"], 2, "--with low=a:B: low is a:A already; expected one class for"),
        (["--node", "high", "--with", "low=a:A"], 1, "--with low=a:A: changes low alone; the other nodes do here what"),
        (["--with", "world=a:A"], 1, "--with world=a:A: changes world alone; the world does here what the recording"),
    ],
)
def test_a_class_that_nothing_is_done_with_is_refused(
    folder: Path, capsys: Capture, arguments: list[str], code: int, what: str
) -> None:
    said(capsys)
    assert main(["replay", "a.mcap", *arguments]) == code
    assert capsys.readouterr().err.startswith(f"error: {what}")


def test_a_replay_keeps_the_pace(folder: Path, capsys: Capture) -> None:
    assert main(["replay", "a.mcap", "--speed", "1000", "--to", "3"]) == 0


@pytest.mark.parametrize(
    ("arguments", "code", "what"),
    [
        (["replay", "--speed", "1e-300"], 1, "--speed 1e-300: expected 0, or a number from 1e-06 on"),
        (["replay", "--speed", "nan"], 2, "Invalid value for '--speed'"),
        (["replay", "--verify", "--tolerance", "inf"], 2, "expected a finite number, got inf"),
        (["diff", "a.mcap", "--tolerance", "inf"], 2, "expected a finite number, got inf"),
        (["diff", "a.mcap", "--tolerance", "nan"], 2, "Invalid value for '--tolerance'"),
    ],
)
def test_numbers_that_are_too_large_or_none_are_refused(
    folder: Path, capsys: Capture, arguments: list[str], code: int, what: str
) -> None:
    assert main([arguments[0], "a.mcap", *arguments[1:]]) == code
    error = capsys.readouterr().err
    assert what in error
    assert "Traceback" not in error


def test_diff_names_the_place(folder: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    assert main(["diff", "a.mcap", "flawed.yaml"]) == 0
    monkeypatch.setenv(FLAW, "high/predict/4")
    assert main(["run", "flawed.yaml", "--record", "b.mcap"]) == 0
    said(capsys)
    for other in ("b.mcap", "flawed.yaml"):
        assert main(["diff", "a.mcap", other]) == 1
        lines = said(capsys).splitlines()
        assert lines[0] == "first difference: epoch 4, high, predict: belief.trail[2]"
        assert lines[1].startswith("  a.mcap ")
        assert lines[2].startswith(f"  {other} ")
        assert lines[3] == "3 epochs before it are alike"
    assert main(["diff", "a.mcap", "b.mcap", "--to", "3"]) == 0
    assert main(["diff", "a.mcap", "b.mcap", "--tolerance", "0.5", "--format", "json"]) == 0
    monkeypatch.delenv(FLAW)
    assert main(["diff", "b.mcap", "flawed.yaml", "--world", "recorded"]) == 1


def test_what_strangers_have_recorded_moves_no_cursor(capsys: Capture) -> None:
    moves = "\x1b]0;owned\x07\x1b[2J\n"
    comparison = Comparison(
        epochs=3,
        difference=Difference(3, "arm", f"policy p{moves}", f"actions[0].{moves}", {moves: moves}, moves),
        rosters=[RosterDifference(1, f"nodes.arm.parameters.{moves}", {moves: 1}, None)],
    )
    print_comparison(comparison, "a.mcap", "b.mcap")
    lines = said(capsys).splitlines()
    written = r"\x1b]0;owned\x07\x1b[2J\n"
    assert lines[0] == f"rosters differ from epoch 1: nodes.arm.parameters.{written}"
    assert lines[3] == f"first difference: epoch 3, arm, policy p{written}: actions[0].{written}"
    assert all(line.isprintable() for line in lines)
    assert len(lines) == 7


def test_check_counts_what_it_has_checked(folder: Path, capsys: Capture) -> None:
    said(capsys)
    assert main(["check", "a.mcap"]) == 0
    assert said(capsys) == "a.mcap: 12 epochs, 36 steps of nodes: the formal order is kept\n"
    assert main(["check", "a.mcap", "--format", "json"]) == 0
    assert json.loads(said(capsys)) == {"file": "a.mcap", "epochs": 12, "steps": 36, "violations": []}


def test_a_recording_that_was_cut_off_is_used_and_said(folder: Path, capsys: Capture) -> None:
    data = Path("a.mcap").read_bytes()
    Path("cut.mcap").write_bytes(data[:-200])
    capsys.readouterr()
    assert main(["replay", "cut.mcap", "--verify"]) == 0
    out, err = capsys.readouterr()
    assert err.startswith("hierax: cut.mcap: it was cut off: its last chunk")
    assert out.endswith("12 epochs, 12 digests: all results are alike\n")


def test_a_node_that_was_detached_before_is_not_told_to_be_alike(folder: Path, capsys: Capture) -> None:
    run = ["run", "flawed.yaml", "--epochs", "6", "--at", "4:detach:high", "--record", "less.mcap"]
    assert main(run) == 0
    assert main(["replay", "less.mcap", "--node", "high", "--from", "3", "--verify"]) == 0
    capsys.readouterr()
    assert main(["replay", "less.mcap", "--node", "high", "--from", "4", "--verify"]) == 1
    told = "in none of the 3 epochs that were replayed was there a node high; expected some with it"
    assert capsys.readouterr().err.splitlines()[-1] == f"error: less.mcap: {told}"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["replay", "nowhere.mcap"], "nowhere.mcap: cannot be read: No such file or directory"),
        (["replay", "flawed.yaml"], "flawed.yaml: is no recording; expected an MCAP file that hierax wrote"),
        (["replay", "a.mcap", "--node", "lwo"], "a.mcap: there is no node 'lwo'; did you mean 'low'?"),
        (["replay", "a.mcap", "--from", "50"], "a.mcap: there is no epoch to replay from 50"),
        (["replay", "a.mcap", "--set", "gian=1"], "--set gian=1: there is no 'gian'; did you mean 'gain'?"),
        (
            ["replay", "a.mcap", "--node", "high", "--set", "gain=1"],
            "--set gain=1: changes low alone; the other nodes do here what the recording says",
        ),
        (["replay", "a.mcap", "--with", "low"], "--with low: expected NODE=package.module:Class"),
        (["replay", "a.mcap", "--with", "x=a:B"], "a.mcap: there is no node 'x'; the nodes are high, low, world"),
        (["diff", "a.mcap", "b.mcap"], "b.mcap: there is no such recording"),
        (["diff", "a.mcap", "a.mcap", "--set", "x=1"], "--set and --world: only with a deployment as the other run"),
        (["diff", "a.mcap", "a.mcap", "--from", "50"], "a.mcap and a.mcap: there is no epoch that both have"),
        (["record", "-o", "x.mcap"], "no launch runs on this machine"),
        (["run", "flawed.yaml", "--record", "no/x.mcap"], "no/x.mcap: cannot be written: No such file or directory"),
    ],
)
def test_what_cannot_be_done_is_one_line(arguments: list[str], error: str, folder: Path, capsys: Capture) -> None:
    capsys.readouterr()
    assert main(arguments) == 1
    assert capsys.readouterr().err.splitlines()[-1] == f"error: {error}"
