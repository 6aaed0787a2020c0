"""The benchmark of changes runs, and finds its launches repeated to the bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "changes.py"


def test_changes_of_a_launch_are_repeated() -> None:
    command = [sys.executable, str(SCRIPT), "--changes", "2", "--epochs", "1500", "--limit-ms", "1000", "servo"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].endswith(" epochs: digests equal those of the scheduled run")
