from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from support.launched import environment

from hierax.runtime.commands.main import main
from hierax.runtime.watch.prints import named_lines

TALKING = """
import logging
import sys

from hierax.runtime import NO_TICK, Node, World


class Clock(World):
    def initial_belief(self):
        return 0


class Talker(Node):
    def initial_belief(self):
        return None

    def observe(self, observations, belief, tick=NO_TICK):
        print("epoch", end=" ")
        print(tick.epoch, "\\nof many")
        print("a warning of mine", file=sys.stderr)
        logging.getLogger("mine").warning("logged")
        return belief
"""
FILE = """
hierarchy: talking
world: clock
nodes: {clock: {class: "talking:Clock"}, talker: {class: "talking:Talker"}}
edges: {clock -> talker: {}}
"""


def said(folder: Path, mode: str) -> list[str]:
    """What a run of two epochs writes to standard error."""
    (folder / "talking.py").write_text(TALKING)
    (folder / "talking.yaml").write_text(FILE)
    command = [sys.executable, "-m", "hierax.runtime.commands.main", mode, str(folder / "talking.yaml")]
    done = subprocess.run(
        [*command, "--epochs", "2", "--format", "json"],
        capture_output=True,
        text=True,
        timeout=120,
        env={**environment(folder), "XDG_STATE_HOME": str(folder)},
        check=False,
    )
    assert json.loads(done.stdout)["epochs"] == 2, done.stderr
    return done.stderr.splitlines()


def test_what_a_node_prints_has_its_name_and_is_in_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = said(tmp_path, "launch")
    told = ["talker: epoch 1 ", "talker: of many", "talker: a warning of mine", "talker: mine: logged"]
    assert lines == [*told, "talker: epoch 2 ", *told[1:]]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert main(["logs", "--node", "talker", "--grep", "^(of many|a warning|logged)", "--format", "json"]) == 0
    entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(each["epoch"], each["logger"], each["message"]) for each in entries[:3]] == [
        (1, "stdout", "of many"),
        (1, "stderr", "a warning of mine"),
        (1, "mine", "logged"),
    ]
    assert len(entries) == 6


def test_in_one_process_it_has_the_name_of_the_node_whose_turn_it_is(tmp_path: Path) -> None:
    assert "talker: epoch 1 " in said(tmp_path, "run")


def test_a_line_is_named_once() -> None:
    stream = io.StringIO()
    names = iter(("arm", "arm", "", "camera->arm"))
    out = named_lines(stream, lambda: next(names))
    for text in ("a", "b\nc\n", "by nobody\n", "d\n"):
        out.write(text)
    assert stream.getvalue() == "arm: ab\narm: c\nby nobody\ncamera->arm: d\n"
