"""A short time of what `benchmarks/fuzz_keys.py` does for long."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "fuzz_keys.py"


def test_a_launch_goes_on_whatever_is_said_on_its_keys() -> None:
    seed = random.SystemRandom().randrange(10**6)
    command = [sys.executable, str(SCRIPT), "--messages", "3000", "--seed", str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "processes the same, digest equal" in done.stdout
