from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.live import Live

from hierax.runtime.commands.main import main
from hierax.runtime.commands.top import headline, table

NODES = {"world", "low", "high"}


def test_once_as_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    live = Live(tmp_path, pace_s=0.03)  # much longer than the rest of an epoch takes, also where others are at work
    try:
        assert main(["top", "--once", "--interval", "1", "--format", "json"]) == 0
    finally:
        live.close()
    look = json.loads(capsys.readouterr().out)
    assert look["hierarchy"] == "live"
    assert look["epoch"] > 0
    assert look["epochs_per_s"] > 0
    assert look["nodes"].keys() == NODES
    for name, node in look["nodes"].items():
        assert node["answers"], name
        assert node["rss_bytes"] > 10 << 20
        assert sum(node["share"].values()) == pytest.approx(1.0, abs=0.1)
        assert node["per_epoch_us"]["waiting"] > 0
    # the world sleeps in its prediction: everybody else waits for it, at the end of the chain
    working = {kind: share for kind, share in look["nodes"]["world"]["share"].items() if kind != "waiting"}
    assert max(working, key=working.__getitem__) == "predict"
    assert working["predict"] > 2 * sum(share for kind, share in working.items() if kind != "predict")
    assert look["nodes"]["low"]["waits_for"].keys() <= {"world", "high"}
    assert max(look["nodes"]["low"]["waits_for"], key=look["nodes"]["low"]["waits_for"].__getitem__) == "world"


def test_once_as_a_table(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["top", "--once", "--interval", "0.3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"live, run {live.run['run']}: epoch ")
    assert lines[1].split()[:7] == ["node", "state", "epoch", "observe", "policy", "predict", "edges"]
    assert {line.split()[0] for line in lines[3:]} == NODES


LOOK = {
    "hierarchy": "toys",
    "run": "aa",
    "epoch": 7,
    "roster": 1,
    "epochs_per_s": 0.2,
    "epoch_us": {"p50": 5_000_000.0, "p99": 7_000_000.0},
    "nodes": {
        "arm": {
            "state": "running",
            "restarts": 0,
            "answers": True,
            "epoch": 7,
            "doing": "in observe of arm",
            "per_epoch_us": None,
            "share": {
                "observe": 0.9,
                "policy": 0.0,
                "predict": 0.0,
                "edges": 0.0,
                "act": 0.0,
                "other": 0.0,
                "waiting": 0.1,
            },
            "waits_for": {"": 1.0},
            "cpu": 0.5,
            "rss_bytes": 60 << 20,
        },
        "top": {"state": "restarting", "restarts": 3, "answers": False},
        "far": {"state": "running", "restarts": 0, "answers": False},
    },
}


def test_a_node_that_is_long_in_an_operator_and_one_that_is_silent() -> None:
    from rich.console import Console

    console = Console(width=200)
    with console.capture() as capture:
        console.print(table(LOOK))
    head, _, arm, top, far = capture.get().splitlines()
    assert "act" not in head.split()
    assert arm.split() == [
        *("arm", "in", "observe", "of", "arm", "7"),
        *("90%", "0%", "0%", "0%", "0%", "10%", "its", "turn", "100%", "50%", "60", "MB", "0"),
    ]
    assert top.split() == ["top", "restarting", "restarting", "3"]
    assert far.split() == ["far", "no", "answer", "no", "answer", "0"]
    assert headline(LOOK) == "toys, run aa: epoch 7, 0.2 epochs/s, an epoch p50 5 s, p99 7 s, roster version 1"
    counting = {**LOOK, "nodes": {**LOOK["nodes"], "world": {"metrics": {"stalls": 2.0, "passed_over": 117.0}}}}  # type: ignore[dict-item]
    assert headline(counting).endswith(", roster version 1; world: passed_over 117, stalls 2")


def test_what_nodes_say_moves_no_cursor() -> None:
    from rich.console import Console

    moves = "\x1b]0;owned\x07\x1b[2J\n"
    arm = {
        **LOOK["nodes"]["arm"],
        "doing": f"in policy {moves} of arm",
        "metrics": {moves: 1.0},
        "waits_for": {moves: 1.0},
    }  # type: ignore[index]
    look = {**LOOK, "nodes": {"arm": arm}}
    console = Console(width=400)
    with console.capture() as capture:
        console.print(table(look))
    assert all(line.isprintable() for line in capture.get().splitlines())
    assert headline(look).isprintable()


def test_hosts_are_told_where_there_are_several() -> None:
    from rich.console import Console

    console = Console(width=200)
    hosts = {"arm": "robot", "top": "", "far": "desk"}
    nodes = {name: {**LOOK["nodes"][name], "host": host} for name, host in hosts.items()}  # type: ignore[index]
    with console.capture() as capture:
        console.print(table({**LOOK, "nodes": nodes}))
    head, _, arm, top, far = capture.get().splitlines()
    assert head.split()[:3] == ["node", "host", "state"]
    assert (arm.split()[1], top.split()[1], far.split()[1]) == ("robot", "restarting", "desk")


def test_a_narrow_terminal_shows_what_matters() -> None:
    from rich.console import Console

    console = Console(width=80)
    with console.capture() as capture:
        console.print(table(LOOK, 80))
    lines = capture.get().splitlines()
    assert lines[0].split() == [
        "node",
        "epoch",
        "observe",
        "policy",
        "predict",
        "edges",
        "waiting",
        "for",
        "memory",
        "restarts",
    ]
    assert len(lines) == 5


@pytest.mark.parametrize("output_format", ["json", "text"])
def test_a_launch_that_ends_before_it_was_looked_at(
    live: Live, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], output_format: str
) -> None:
    monkeypatch.setattr("hierax.runtime.commands.top.overviews", lambda *_: iter(()))
    assert main(["top", "--once", "--format", output_format]) == 1
    assert capsys.readouterr() == ("", "error: the launch is over\n")


def test_without_a_launch(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("none")))
    for command in (["top", "--once"], ["inspect", "arm"], ["echo", "**"]):
        assert main(command) == 1
        assert capsys.readouterr().err == "error: no launch runs on this machine\n"
