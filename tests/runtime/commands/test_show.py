from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hierax.runtime.commands.show import brief, print_json, print_report
from hierax.runtime.execution.report import NodeReport, Report


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "None"),
        (True, "True"),
        (1 / 3, "0.333333"),
        (np.float64(0.5), "0.5"),
        (b"abc", "3 bytes"),
        ({"x": 1.0, "y": (1, 2)}, "{x: 1, y: [1, 2]}"),
        (np.array([1.0, 2.5]), "[1, 2.5]"),
        (np.zeros((480, 640), np.uint8), "uint8 array 480×640"),
        (tuple(range(100)), "[0, 1, 2, 3, 4, 5, 6, 7, …]"),
        ("x" * 100, "x" * 59 + "…"),
    ],
)
def test_a_value_in_short(value: object, text: str) -> None:
    assert brief(value) == text


def test_json_is_strict() -> None:
    with pytest.raises(ValueError, match="JSON"):
        print_json(float("nan"))


def test_a_report_as_text(capsys: pytest.CaptureFixture[str]) -> None:
    node = NodeReport({"x": 1.0}, "default", (), {"error_mean": 0.25, "count": 3.0})
    report = Report(
        "toys", "launch", 7, 2, bytes(32).hex(), 0.5, [0.25, 0.25], {"[bold]": node}, Path("out"), start_s=0.75
    )
    print_report(report)
    lines = capsys.readouterr().out.splitlines()
    assert lines[:5] == [
        "toys: launch, seed 7, 2 epochs in 0.5 s (4 epochs/s)",
        "epoch: p50 250000 µs, p99 250000 µs",
        "start to first epoch: 0.75 s",
        f"digest: {'00' * 32}",
        "output: out",
    ]
    assert ["[bold]", "default", "count", "3,", "error_mean", "0.25", "{x:", "1}"] in [line.split() for line in lines]


def test_what_a_node_says_moves_no_cursor(capsys: pytest.CaptureFixture[str]) -> None:
    node = NodeReport({"x": 1.0}, "\x1b]0;owned\x07go", (), {"\x1b[2J": 1.0})
    print_report(Report("toys", "run", 7, 2, bytes(32).hex(), 0.5, [0.25, 0.25], {"arm": node}))
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert r"\x1b]0;owned\x07go" in out


def test_a_run_of_no_epoch(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(Report("toys", "run", 0, 0, bytes(32).hex(), 0.0, [], {}))
    assert capsys.readouterr().out.startswith(f"toys: run, seed 0, 0 epochs\ndigest: {'00' * 32}\n")
