"""Launches whose processes are stopped for longer than a link holds, and go on: nothing waits for a deadline."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from support.device_nodes import DEVICE, MOVES_S
from support.launched import Launched, hierax, until

EPOCHS = 400
STOPS_S = (1.05, 1.5, 3.0)
"""Just over a link's lease, and well over it."""


@pytest.mark.parametrize("seed", [1])
def test_epochs_go_on_by_themselves_after_stops(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With no deadline at all: whatever was lost with the links is said again when they are back."""
    file = tmp_path / "device.yaml"
    log = tmp_path / "device.log"
    file.write_text(DEVICE.format(log=log, on_uncertain_act="repeat", deadline_s="null", eye=""), encoding="utf-8")
    wanted = hierax("run", str(file), "--epochs", str(EPOCHS))["digest"]
    monkeypatch.setenv(MOVES_S, "0.005")
    rng = random.Random(seed)
    nodes = ("arm", "eye", "spatial", "world")
    stopped = [[name] for name in rng.sample((*nodes, "supervisor"), 3)]
    with Launched(tmp_path, str(file), "--epochs", str(EPOCHS)) as launch:
        launch.until_epoch(5)
        for who, for_s in zip([*stopped, [*nodes, "supervisor"]], [*STOPS_S, 1.2], strict=True):
            pids = [launch.process.pid if name == "supervisor" else launch.until_pid(name) for name in who]
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            time.sleep(for_s)
            epoch = launch.epoch
            for pid in pids:
                os.kill(pid, signal.SIGCONT)
            until(
                lambda epoch=epoch: launch.epoch > epoch,
                f"an epoch after {who} were stopped for {for_s} s, seed {seed}",
            )  # type: ignore[misc]
        launch.end()
        assert launch.process.returncode == 0, launch.err
        assert launch.written[EPOCHS].hex() == wanted, f"seed {seed}"
        assert "started again" not in launch.err
        assert "deadline" not in launch.err
