"""A short time of what `benchmarks/fuzz_keys.py` does for long."""

from __future__ import annotations

import random
import runpy
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from hierax.schemas.control import Control, decode_control
from hierax.schemas.values import encode_value

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "fuzz_keys.py"


def test_a_launch_goes_on_whatever_is_said_on_its_keys() -> None:
    seed = random.SystemRandom().randrange(10**6)
    command = [sys.executable, str(SCRIPT), "--messages", "3000", "--seed", str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "processes the same, digest equal" in done.stdout


def test_its_grammar_says_each_kind_of_control_message_as_it_is_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    script = runpy.run_path(str(SCRIPT))
    grammar = script["Grammar"](random.Random(1), None, dict.fromkeys(("world", "low", "high"), "token"))
    assert script["KINDS_OF_CONTROL"].keys() == {kind.__name__ for kind in get_args(Control)}
    for kind, count in script["KINDS_OF_CONTROL"].items():
        said = decode_control(encode_value((kind, *(grammar._fitting(kind, index) for index in range(count)))))
        assert type(said).__name__ == kind
