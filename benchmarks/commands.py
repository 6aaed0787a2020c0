"""Commands of hierax as the benchmarks run them: each in a process of its own."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import Any


def at_least(least: int) -> Callable[[str], int]:
    """For `argparse`: a whole number that is no smaller than this."""

    def number(text: str) -> int:
        value = int(text) if text.lstrip("-").isdecimal() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"{text}: expected a whole number from {least} on")
        return value

    return number


HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]


def reported(
    what: str,
    command: str,
    *arguments: str,
    timeout_s: float | None = None,
    environment: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """The report of a command, run or launch. Where it fails, the program ends with what it has said, after `what`."""
    words = [*HIERAX, command, "--format", "json", *arguments]
    done = subprocess.run(words, capture_output=True, text=True, timeout=timeout_s, env=environment, check=False)
    if done.returncode:
        raise SystemExit(f"{what}: {done.stderr.strip()}")
    return dict(json.loads(done.stdout))
