from __future__ import annotations

import json

import numpy as np
import pytest

from hierax.runtime.execution.report import NodeReport, Report


def test_the_json_of_a_report() -> None:
    node = NodeReport({"pose": np.array([1.0, np.nan])}, "default", (1, b"\x01"), {"error": 0.25})
    report = Report("toys", "run", 7, 3, bytes(32).hex(), 0.5, [0.001, 0.002, 0.003], {"arm": node})
    assert json.loads(json.dumps(report.plain(), allow_nan=False)) == {
        "hierarchy": "toys",
        "mode": "run",
        "epochs": 3,
        "seed": 7,
        "digest": "00" * 32,
        "wall_s": 0.5,
        "epoch_us": {"p50": pytest.approx(2000.0), "p99": pytest.approx(2980.0)},
        "nodes": {
            "arm": {
                "belief": {"pose": [1.0, "NaN"]},
                "policy": "default",
                "actions": [1, "01"],
                "metrics": {"error": 0.25},
            }
        },
    }
    assert report.epochs_per_s == 6.0


def test_a_run_without_an_epoch_has_no_times() -> None:
    report = Report("toys", "run", 0, 0, bytes(32).hex(), 0.0, [], {})
    assert report.plain()["epoch_us"] == {"p50": None, "p99": None}
    assert report.epochs_per_s is None
