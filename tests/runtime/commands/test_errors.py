from __future__ import annotations

import os
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from hierax.runtime.commands import errors
from hierax.runtime.commands.errors import TRACEBACK_VARIABLE, CommandError, UsageError, exit_code, unhindered
from hierax.schemas.errors import SchemaError


def failing(error: BaseException) -> int:
    raise error


def test_the_commands_own_code() -> None:
    assert exit_code(lambda: 0) == 0
    assert exit_code(lambda: 1) == 1


@pytest.mark.parametrize("error", [CommandError("the disk\n  is full"), SchemaError("is full", "the disk")])
def test_an_expected_failure_is_one_line(
    error: Exception, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TRACEBACK_VARIABLE, raising=False)
    assert exit_code(lambda: failing(error)) == 1
    out, err = capsys.readouterr()
    assert (out, err.replace(":", "")) == ("", "error the disk is full\n")


def test_what_a_command_does_not_take_has_a_code_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(lambda: failing(UsageError("expected a name"))) == 2
    assert capsys.readouterr().err == "error: expected a name\n"


def test_the_traceback_of_a_failure_on_demand(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TRACEBACK_VARIABLE, "1")
    assert exit_code(lambda: failing(CommandError("the disk is full"))) == 1
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.endswith("error: the disk is full\n")


@pytest.mark.parametrize("named", ["/closed/recording", b"/closed/recording"])
def test_a_file_that_the_system_refuses_is_one_line(
    named: str | bytes, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TRACEBACK_VARIABLE, raising=False)
    assert exit_code(lambda: failing(PermissionError(13, "Permission denied", named))) == 1
    assert capsys.readouterr().err == "error: /closed/recording: Permission denied\n"
    assert exit_code(lambda: Path("x" * 300).is_dir()) == 1
    assert capsys.readouterr().err == f"error: {'x' * 300}: File name too long\n"


def test_what_the_system_refuses_without_a_file_is_a_bug(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(lambda: failing(OSError(9, "Bad file descriptor"))) == 3
    assert "Traceback" in capsys.readouterr().err


def test_a_bug_has_its_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(lambda: failing(ZeroDivisionError("by zero"))) == 3
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert "ZeroDivisionError: by zero" in err
    assert err.endswith("error: this is a bug, in hierax or in a node: please report it with the lines above\n")


def test_ctrl_c(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(lambda: failing(KeyboardInterrupt())) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_terminal_that_is_paused_holds_nobody_up_who_keeps_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    screen, terminal = os.openpty()
    monkeypatch.setattr(errors, "own_errors", lambda: terminal)
    with unhindered() as tell:
        termios.tcflow(terminal, termios.TCOOFF)
        for number in range(1000):
            tell(f"notice {number}")
        termios.tcflow(terminal, termios.TCOON)
        tell("read \x1b[2J again")
    shown = os.read(screen, 1 << 16).replace(b"\r\x1b[2K", b"").decode().splitlines()
    assert shown == [
        "hierax: notice 0",
        "999 lines were left out here, as nobody read them",
        "hierax: read \\x1b[2J again",
    ]
    os.close(screen)
    os.close(terminal)


def test_a_reader_that_has_gone_is_no_bug() -> None:
    script = """
from hierax.runtime.commands.errors import exit_code
def talk():
    for _ in range(100_000):
        print("a line")
    return 0
raise SystemExit(exit_code(talk))
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 1
