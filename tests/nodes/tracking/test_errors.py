"""How the tracking programs end."""

from __future__ import annotations

import subprocess
import sys

import pytest

from hierax.nodes.tracking.errors import printed

MANY = "import sys; from hierax.nodes.tracking.errors import printed; sys.exit(printed(lambda: 'x\\n' * 1_000_000))"


def test_a_reader_that_has_gone_ends_a_program_without_a_word() -> None:
    with subprocess.Popen([sys.executable, "-c", MANY], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        program.stdout.close()
        assert program.stderr.read() == b""
    assert program.returncode == 1


def test_ctrl_c_is_told_in_a_word(capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    assert printed(interrupted) == 130
    assert capsys.readouterr().err == "interrupted\n"
