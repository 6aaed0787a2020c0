"""The benchmark of picking: its figures, its verdict, and what it refuses."""

from __future__ import annotations

import json
import subprocess
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hierax.nodes.tracking.evaluation.scoring import ObjectErrors

PATH = Path(__file__).parents[2] / "benchmarks" / "pick.py"


def load() -> Any:
    spec = util.spec_from_file_location("pick", PATH)
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


pick = load()


def report(grasped: float) -> dict[str, Any]:
    world = {"metrics": {"grasped": grasped, "lift_mm": 129.5, "held_s": 2.55}}
    grasp = {"metrics": {"target": 4.0, "attempts": 1.0}}
    return {"nodes": {"world": world, "grasp": grasp}, "epochs": 180, "wall_s": 9.0, "digest": "ab" * 32}


ERRORS = [
    ObjectErrors(
        4, np.arange(40), np.r_[6.0, np.full(29, 0.2), np.full(10, 0.6)], np.r_[3.0, np.full(39, 0.1)], np.ones(40)
    ),
    ObjectErrors(5, np.arange(40), np.full(40, 99.0), np.full(40, 99.0), np.ones(40)),
]


def answers(monkeypatch: pytest.MonkeyPatch, failing: int) -> list[list[str]]:
    """Have so many scenes fail; what was called."""
    calls: list[list[str]] = []

    def run(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        calls.append(words)
        return subprocess.CompletedProcess(words, 0, json.dumps(report(float(len(calls) > failing))), "")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(pick, "read_errors", lambda folder: ERRORS)
    return calls


def test_one_failure_of_twenty_is_allowed_and_two_are_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for failing, code in ((0, 0), (1, 0), (2, 1)):
        answers(monkeypatch, failing)
        assert pick.main([]) == code
        assert f"{20 - failing} of 20 grasped" in capsys.readouterr().out


def test_scenes_and_settings_are_passed_on(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    calls = answers(monkeypatch, 0)
    assert pick.main(["--scenes", "3:5", "--launch", "--set", "target=3", "--format", "json"]) == 0
    assert [words[-1] for words in calls] == ["scene=3", "scene=4"]
    assert all({"launch", "pick", "target=3"} <= set(words) for words in calls)
    assert [each["scene"] for each in json.loads(capsys.readouterr().out)] == [3, 4]


def test_a_row_says_what_happened() -> None:
    row = pick.line(pick.measured(7, report(0.0), ERRORS))
    assert row.split()[:4] == ["7", "NO", "4", "1"]
    assert "129.5" in row


def test_errors_are_those_of_the_cube_that_was_tried_at_the_start_and_after_it() -> None:
    each = pick.measured(7, report(1.0), ERRORS)
    assert each.errors == pytest.approx((6.0, 3.0, 0.4, 0.1, 0.6))


def test_without_an_attempt_there_are_no_errors() -> None:
    none = report(0.0)
    none["nodes"]["grasp"]["metrics"]["target"] = 0.0
    each = pick.measured(7, none, ERRORS)
    assert each.errors is None
    assert pick.as_dict(each)["errors"] is None
    assert "–" in pick.line(each)


def test_a_failed_run_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", lambda words, **_: subprocess.CompletedProcess(words, 3, "", "no such file"))
    with pytest.raises(SystemExit, match="scene 0: run failed: no such file"):
        pick.main([])


@pytest.mark.parametrize("scenes", ["5", "3:3", "a:b"])
def test_scenes_must_be_a_range(scenes: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        pick.main(["--scenes", scenes])
    assert "expected A:B" in capsys.readouterr().err
