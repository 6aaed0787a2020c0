from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from support.deployments import write

from hierax.runtime.commands.main import COMMANDS, app_of, main


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hierax {version('hierax')}\n"


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], *([command.__name__, "-h"] for command in COMMANDS)])
def test_help(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    assert "Usage: hierax" in capsys.readouterr().out


def test_no_command_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) in (0, 2)  # typer's versions differ
    assert "Usage: hierax" in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "rnu"),
        (["run"], "FILE"),
        (["run", "letters", "--epoch", "3"], "--epoch"),
        (["run", "letters", "--epochs", "0"], "--epochs"),
        (["run", "letters", "--epochs", "-1"], "--epochs"),
        (["run", "letters", "--epochs", "x"], "--epochs"),
        (["launch", "letters", "--seed", "-1"], "--seed"),
        (["validate", "letters", "--format", "xml"], "--format"),
        (["graph", "letters", "more"], "more"),
    ],
)
def test_usage_errors(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert "Traceback" not in out + err


@pytest.mark.parametrize("command", ["run", "launch", "validate", "graph"])
def test_a_wrong_file_is_one_line_on_standard_error(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "lettres"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        "error: lettres: there is no such file, and no shipped deployment of that name; did you mean 'letters'?\n"
    )


NO_UTF8 = os.fsdecode(b"d\xff")
NAMED = "expected a path in UTF-8; rename what is not, or name another one"


@pytest.mark.parametrize(
    "command",
    [
        ["run", f"{NO_UTF8}/toys.yaml"],
        ["launch", f"{NO_UTF8}/toys.yaml"],
        ["validate", f"{NO_UTF8}/toys.yaml"],
        ["export", "systemd", f"{NO_UTF8}/toys.yaml", "-o", "units"],
        ["export", "systemd", "toys.yaml", "-o", NO_UTF8],
        ["run", "toys.yaml", "--output", NO_UTF8],
        ["run", "toys.yaml", "--record", f"{NO_UTF8}.mcap"],
        ["launch", "toys.yaml", "--state", NO_UTF8],
        ["launch", "toys.yaml", "--output", NO_UTF8],
    ],
)
def test_a_path_that_is_not_utf8_is_one_line_and_nothing_is_written(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path)
    (tmp_path / NO_UTF8).mkdir()
    write(tmp_path / NO_UTF8)
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.chdir(tmp_path)
    assert main(command) == 1
    err = capsys.readouterr().err
    assert (err.count("\n"), err.count("\\udcff")) == (1, 1)
    assert NAMED in err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_working_folder_that_is_not_utf8_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / NO_UTF8).mkdir()
    monkeypatch.chdir(tmp_path / NO_UTF8)
    assert main(["launch", str(write(tmp_path)), "--epochs", "1"]) == 1
    assert NAMED in capsys.readouterr().err


def test_a_wrong_override_is_one_line_on_standard_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(write(tmp_path)), "--set", "steep=3"]) == 1
    assert capsys.readouterr().err == "error: --set steep=3: there is no 'steep'; did you mean 'step'?\n"


def test_a_command_makes_only_itself_ready() -> None:
    everything = {command.callback.__name__ for command in app_of([]).registered_commands if command.callback}
    for command in COMMANDS:
        (alone,) = app_of([command.__name__, "--epochs"]).registered_commands
        assert alone.callback is not None
        assert alone.callback.__name__ == command.__name__
    assert {command.__name__ for command in COMMANDS} < everything


@pytest.mark.parametrize("of_nodes", [["infer"], ["bench", "epoch"], ["bench", "tracking"]])
def test_what_comes_with_nodes_is_found(of_nodes: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*of_nodes, "--help"]) == 0
    assert f"Usage: hierax {' '.join(of_nodes)}" in capsys.readouterr().out


def test_a_run_imports_nothing_of_links_and_recordings() -> None:
    script = """
import sys
from hierax.runtime.commands.main import main
code = main(["run", "chain", "--epochs", "1"])
print(code, sorted({"zenoh", "mcap", "rerun", "opentelemetry"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("\n0 []\n")


def test_help_is_quick_as_it_imports_nothing_heavy() -> None:
    script = """
import sys
from hierax.runtime.commands.main import main
main(["run", "--help"])
print(sorted({"yaml", "anyio", "zenoh", "pybullet", "cv2"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("\n[]\n")
