"""The rival's processes do not outlive the command."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.launched import Command, is_alive, processes_of, until

from hierax.runtime.bench.epoch import from_commit_to_commit


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_bench_that_is_ended_leaves_nobody_behind(tmp_path: Path, number: signal.Signals) -> None:
    with Command(tmp_path, "bench", "epoch", "--epochs", str(10**9)) as bench:
        chain: list[int] = []

        def is_under_way() -> bool:
            chain[:] = [pid for pid in processes_of(bench.process.pid) if b"bare_chain" in command_line(pid)]
            return any(b"\0world\0" in command_line(pid) for pid in chain)

        try:
            until(is_under_way, "the rival's world")
            bench.process.send_signal(number)
            until(lambda: not any(is_alive(pid) for pid in chain), f"the end of {chain}")
            assert bench.end() == ""
        finally:
            for pid in filter(is_alive, chain):
                os.kill(pid, signal.SIGKILL)


def test_what_lies_between_epochs_counts() -> None:
    report: Any = SimpleNamespace(wall_s=1.0, epochs_s=[0.2, 0.3, 0.1, 0.2])
    assert from_commit_to_commit(report) == pytest.approx([0.25, 0.35, 0.15, 0.25])


def command_line(pid: int) -> bytes:
    """What a process was started with, ended by zeros; empty: it is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""
