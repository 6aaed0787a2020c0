"""What stands on standard output, and what becomes of a process that cannot write there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HIERAX = f"{sys.executable} -m hierax.runtime.commands.entry"
COMMANDS = ("graph servo", "run servo --epochs 2", "run servo --epochs 2 --format json", "--help", "ps")


def shell(line: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """What a shell's line says."""
    return subprocess.run(
        ["bash", "-c", line],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={**os.environ, **environment},
        check=False,
    )


@pytest.fixture(autouse=True)
def _alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.mark.parametrize("command", COMMANDS)
def test_characters_that_there_are_not_are_replaced(command: str) -> None:
    plain = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    done = shell(f"{HIERAX} {command}", **plain)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.isascii()
    if "json" in command:
        json.loads(done.stdout)


@pytest.mark.parametrize("command", COMMANDS[:1] + COMMANDS[2:4])
@pytest.mark.parametrize(
    ("where", "told"),
    [
        (">&-", "error: standard output: cannot be written: Bad file descriptor\n"),
        ("> /dev/full", "error: standard output: cannot be written: No space left on device\n"),
        ("| head -0", ""),
    ],
)
def test_output_that_goes_nowhere_is_no_bug(command: str, where: str, told: str) -> None:
    done = shell(f"{HIERAX} {command} {where}; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stdout, done.stderr) == (1, "", told)


@pytest.mark.parametrize("where", ["2> /dev/full", "2>&- <&-"])
def test_errors_that_go_nowhere_stay_out_of_the_output(where: str) -> None:
    done = shell(f"{HIERAX} launch chain --epochs 3 --format json {where}")
    assert json.loads(done.stdout)["epochs"] == 3
    assert (done.returncode, done.stderr) == (0, "")
    assert shell(f"{HIERAX} graph nothing {where}").stdout == ""


def test_what_zenoh_prints_does_not_mix_with_json(tmp_path: Path) -> None:
    """A launch with a recorder, which has a session, too, and tells the supervisor of itself on standard output."""
    record = f"--record {tmp_path / 'a.mcap'} --check"
    done = shell(f"{HIERAX} launch chain --epochs 3 --format json {record}", RUST_LOG="debug")
    assert done.returncode == 0, done.stderr[-2000:]
    assert json.loads(done.stdout)["epochs"] == 3
    assert "zenoh" in done.stderr


def test_what_others_write_to_descriptor_1_goes_to_standard_error() -> None:
    script = (
        "import os; from hierax.runtime.host.streams import own_streams; own_streams(); "
        "os.write(1, b'theirs'); print('ours', '\\u2713')"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        check=True,
    )
    assert (done.stdout, done.stderr) == (b"ours \\u2713\n", b"theirs")
