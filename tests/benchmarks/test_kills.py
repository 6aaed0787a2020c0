"""What `benchmarks/kills.py` kills launches of: the tracking deployment, with a device that acts once in each epoch."""

from __future__ import annotations

from pathlib import Path

import kills
import pytest
from support.device_cubes import LOG
from support.device_nodes import acts
from support.launched import run_here


def test_the_device_beside_tracking_acts_once_in_each_epoch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "device.log"
    monkeypatch.setenv(LOG, str(log))
    run_here(kills.deployment(tmp_path, with_device=True), "--epochs", "2")
    assert acts(log) == [1, 2]
