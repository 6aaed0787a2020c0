from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from support.deployments import write

from hierax.runtime.commands.main import COMMANDS, main


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


def test_a_wrong_override_is_one_line_on_standard_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(write(tmp_path)), "--set", "steep=3"]) == 1
    assert capsys.readouterr().err == "error: --set steep=3: there is no 'steep'; did you mean 'step'?\n"


def test_help_is_quick_as_it_imports_nothing_heavy() -> None:
    script = """
import sys
from hierax.runtime.commands.main import main
main(["run", "--help"])
print(sorted({"yaml", "anyio", "zenoh", "pybullet", "cv2"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("\n[]\n")
