from __future__ import annotations

import fcntl
import io
import json
import os
import select
import subprocess
import sys
from pathlib import Path

import pytest
from support.launched import environment

from hierax.runtime.commands.main import main
from hierax.runtime.watch import prints
from hierax.runtime.watch.prints import LINE_BYTES, Console, Lines, NamedLines

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


def command(mode: str, folder: Path) -> list[str]:
    """Runs what stands in a folder."""
    return [
        sys.executable,
        "-m",
        "hierax.runtime.commands.entry",
        mode,
        str(folder / "talking.yaml"),
        "--format",
        "json",
    ]


def surroundings(folder: Path) -> dict[str, str]:
    """In which launches and their logs are those of the folder."""
    return {**environment(folder), "XDG_STATE_HOME": str(folder)}


def said(folder: Path, mode: str, talking: str = TALKING) -> list[str]:
    """What a run of two epochs writes to standard error."""
    (folder / "talking.py").write_text(talking)
    (folder / "talking.yaml").write_text(FILE)
    done = subprocess.run(
        [*command(mode, folder), "--epochs", "2"],
        capture_output=True,
        text=True,
        timeout=120,
        env=surroundings(folder),
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


def test_what_libraries_and_programs_print_is_named_and_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    in_c = """
        import ctypes, os, subprocess
        ctypes.CDLL(None).puts(b"by C")
        os.write(2, b"by nobody's stream\\n")
        subprocess.run(["echo", "by a program"], check=True)
        subprocess.run(["echo", "by another"], stdout=sys.stdout, check=True)
        if tick.epoch == 2 and not os.path.exists(MARK):
            open(MARK, "w").close()
            os.write(1, b"last words")
            os.kill(os.getpid(), 9)
        return belief"""
    talking = TALKING.replace("        return belief", in_c).replace(
        "class Clock", f"MARK = {str(tmp_path / 'm')!r}\nclass Clock"
    )
    lines = said(tmp_path, "launch", talking)
    for told in ("by C", "by nobody's stream", "by a program", "by another"):
        assert lines.count(f"talker: {told}") == 3, lines
    assert not [line for line in lines if not line.startswith(("talker: ", "hierax: "))], lines
    killed = next(number for number, line in enumerate(lines) if "SIGKILL" in line)
    assert lines[killed - 1] == "talker: last words"
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert main(["logs", "--node", "talker", "--grep", "^(by|last) ", "--format", "json"]) == 0
    entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {each["logger"] for each in entries} == {"output"}
    assert len(entries) == 13


def test_a_console_that_nobody_reads_holds_nobody_up(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    logged: list[str] = []
    lines = Lines("arm", Console(writing), logged.append)
    for number in range(20_000):
        lines.write(b"%d\n" % number)
    assert len(logged) == 20_000
    told = os.read(reading, 1 << 20)
    lines.write(b"read again\n")
    last = (told + os.read(reading, 1 << 20)).decode().splitlines()
    assert last[-1] == "arm: read again"
    shown = len(last) - 2
    assert last[:shown] == [f"arm: {number}" for number in range(shown)]
    assert last[-2] == f"{20_000 - shown} lines were left out here, as nobody read them"
    for descriptor in (reading, writing):
        os.close(descriptor)


def test_what_somebody_else_tells_is_neither_shown_nor_logged_however_long_it_is() -> None:
    reading, writing = os.pipe()
    logged: list[str] = []
    lines = Lines("arm", Console(writing), logged.append, lambda line: line.startswith("zenoh"))
    lines.write(b"one\nzenoh: " + b"x" * (2 * LINE_BYTES))
    lines.write(b"x" * (2 * LINE_BYTES))
    lines.write(b"x\ntwo\nzenoh: short\nthree\n")
    assert logged == ["one", "two", "three"]
    assert os.read(reading, 1 << 16) == b"arm: one\narm: two\narm: three\n"
    for descriptor in (reading, writing):
        os.close(descriptor)


def test_a_launch_whose_console_nobody_reads_goes_on(tmp_path: Path) -> None:
    much = """
        import os
        for _ in range(3000):
            print("by Python, and more of it, as there is a pipe to be filled, that has room for 64 KiB")
            os.write(1, b"by nobody's stream, and as much of it, at the same time, in the same place\\n")
        return belief"""
    (tmp_path / "talking.py").write_text(TALKING.replace("        return belief", much))
    (tmp_path / "talking.yaml").write_text(FILE)
    launch = subprocess.Popen(
        [*command("launch", tmp_path), "--epochs", "3"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=surroundings(tmp_path),
    )
    try:
        assert launch.stdout is not None
        assert json.loads(launch.stdout.read())["epochs"] == 3
        assert launch.wait(120) == 0
    finally:
        launch.kill()
        launch.communicate()


def test_a_process_comes_back_where_nobody_reads_that_it_has_died(tmp_path: Path) -> None:
    dying = """
        import os
        if tick.epoch == 2 and not os.path.exists("dead"):
            os.mkdir("dead")
            os.kill(os.getpid(), 9)
        return belief"""
    (tmp_path / "talking.py").write_text(TALKING.replace("        return belief", dying))
    (tmp_path / "talking.yaml").write_text(FILE)
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, select.PIPE_BUF)
    os.write(writing, bytes(fcntl.fcntl(writing, fcntl.F_GETPIPE_SZ)))  # there is no room from the beginning
    launch = subprocess.Popen(
        [*command("launch", tmp_path), "--epochs", "4"],
        stdout=subprocess.PIPE,
        stderr=writing,
        cwd=tmp_path,
        env=surroundings(tmp_path),
    )
    try:
        told, _ = launch.communicate(timeout=60)
        assert json.loads(told)["epochs"] == 4
        assert (tmp_path / "dead").exists()
    finally:
        launch.kill()
        launch.communicate()
        os.close(reading)
        os.close(writing)


def test_in_one_process_it_has_the_name_of_the_node_whose_turn_it_is(tmp_path: Path) -> None:
    assert "talker: epoch 1 " in said(tmp_path, "run")


IN_TURNS = """
import ctypes, os, subprocess, sys
from hierax.runtime import NO_TICK, Node, World

def talk(who, tick):
    ctypes.CDLL(None).puts(b"by C for " + who)
    os.write(2, b"by nobody's stream for %b\\n" % who)
    if tick.epoch == 1:
        subprocess.run(["echo", "by a program for " + who.decode()], check=True)
    if tick.epoch == 2 and "end" in who.decode():
        os.write(1, bytes(1 << 20) + b"last words")
        os.kill(os.getpid(), 9)

class Clock(World):
    def initial_belief(self):
        return 0
    def predict(self, context, actions, belief, tick=NO_TICK):
        talk(b"clock", tick)
        return belief

class Talker(Node):
    def __init__(self, who="talker"):
        self.who = who.encode()
    def initial_belief(self):
        return None
    def observe(self, observations, belief, tick=NO_TICK):
        talk(self.who, tick)
        return belief
"""


def test_in_one_process_what_libraries_and_programs_print_has_the_name_of_whose_turn_it_is(tmp_path: Path) -> None:
    lines = said(tmp_path, "run", IN_TURNS)
    for who in ("clock", "talker"):
        for what, count in (("C", 2), ("nobody's stream", 2), ("a program", 1)):
            assert lines.count(f"{who}: by {what} for {who}") == count, lines
    assert len(lines) == 10


def test_last_words_of_a_run_that_is_killed_are_shown(tmp_path: Path) -> None:
    (tmp_path / "talking.py").write_text(IN_TURNS)
    (tmp_path / "talking.yaml").write_text(FILE.replace('Talker"', 'Talker", parameters: {who: the end}'))
    done = subprocess.run(
        [*command("run", tmp_path), "--epochs", "2"],
        capture_output=True,
        timeout=120,
        env=surroundings(tmp_path),
        check=False,
    )
    assert done.returncode == -9
    assert done.stderr.endswith(b"last words\n")
    assert done.stderr.rpartition(b"talker: ")[2].strip(b"\0") == b"last words\n"


def test_who_prints_after_a_long_silence_is_named_from_then_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    given = [os.dup(1), os.dup(2)]
    monkeypatch.setattr(prints, "TURNS", 3)
    monkeypatch.setattr(prints, "own_errors", lambda: writing)
    try:
        with prints.named_turns(["a", "b"], "both") as turn:
            assert turn is not None
            for name in "abab":
                turn(name)
            os.write(1, b"one\n")
            assert os.read(reading, 100) == b"both: one\n"
            for name in "bab":
                turn(name)
            os.write(1, b"two\n")
            assert os.read(reading, 100) == b"b: two\n"
    finally:
        for number, descriptor in enumerate(given, 1):
            os.dup2(descriptor, number)
        for descriptor in (reading, writing, *given):
            os.close(descriptor)


def test_a_line_is_named_once() -> None:
    stream = io.StringIO()
    names = iter(("arm", "arm", "", "camera->arm"))
    out = NamedLines(stream, lambda: next(names))
    for text in ("a", "b\nc\n", "by nobody\n", "d\n"):
        out.write(text)
    assert stream.getvalue() == "arm: ab\narm: c\nby nobody\ncamera->arm: d\n"
