"""Launches whose processes are stopped for longer than a link holds, or killed as they start."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from support.device_nodes import DEVICE, MOVES_S
from support.hanging_nodes import GREETS, HUNG
from support.launched import Launched, processes_of, run_here, until
from support.live import DEPLOYMENT, MIXING
from support.sweep import examples

EPOCHS = 1500  # more than go by while the supervisor alone is stopped
STOPS_S = (1.05, 1.5, 3.0)
"""Just over a link's lease, and well over it."""

OUTLIVING, OUTLIVING_MOVE_S = 100, 0.06
"""Epochs, and how long each takes at least: longer in all than the last kill may come after the first process."""


@pytest.mark.parametrize("seed", [1])
def test_epochs_go_on_by_themselves_after_stops(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With no deadline at all: whatever was lost with the links is said again when they are back."""
    file = tmp_path / "device.yaml"
    log = tmp_path / "device.log"
    file.write_text(DEVICE.format(log=log, on_uncertain_act="repeat", deadline_s="null", eye=""), encoding="utf-8")
    wanted = run_here(str(file), "--epochs", str(EPOCHS))["digest"]
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


@pytest.mark.parametrize("seed", [1, 2][: examples(1, 2)])
def test_processes_may_be_killed_in_their_first_instants(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those that start, and of those that come in their place."""
    file = tmp_path / "device.yaml"
    log = tmp_path / "device.log"
    file.write_text(DEVICE.format(log=log, on_uncertain_act="repeat", deadline_s="null", eye=""), encoding="utf-8")
    wanted = run_here(str(file), "--epochs", str(OUTLIVING))["digest"]
    monkeypatch.setenv(MOVES_S, str(OUTLIVING_MOVE_S))
    rng = random.Random(seed)
    kills, seen = 0, set[int]()
    due: dict[int, float] = {}
    with Launched(tmp_path, str(file), "--epochs", str(OUTLIVING)) as launch:
        while launch.running:
            for pid in set(processes_of(launch.process.pid)) - seen:
                seen.add(pid)
                if kills + len(due) < 5:
                    due[pid] = time.monotonic() + rng.choice((0.0, rng.uniform(0.0, 2.0)))
            for pid in [pid for pid, at_s in due.items() if time.monotonic() >= at_s]:
                del due[pid]
                os.kill(pid, signal.SIGKILL)
                kills += 1
            time.sleep(0.001)
        launch.end()
        assert launch.process.returncode == 0, f"seed {seed}: {launch.err}"
        assert launch.written[OUTLIVING].hex() == wanted, f"seed {seed}"
        assert launch.err.count("by signal SIGKILL; it is started again") == kills >= 4
    assert sorted(set(map(int, log.read_text().split()))) == list(range(1, OUTLIVING + 1))


@pytest.mark.parametrize("hung", ["opens", GREETS])
def test_a_process_in_which_zenoh_hangs_before_it_has_a_part_ends_itself_and_another_one_comes(
    hung: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "hanging.yaml"
    text = DEPLOYMENT.format(stop=tmp_path / "stop").replace(f"{MIXING}:Mixer", "support.hanging_nodes:Hanging")
    file.write_text(text, encoding="utf-8")
    wanted = run_here(str(file), "--epochs", str(OUTLIVING))["digest"]
    monkeypatch.setenv(HUNG, str(tmp_path / hung))
    with Launched(tmp_path, str(file), "--epochs", str(OUTLIVING)) as launch:
        launch.end()
        assert launch.process.returncode == 0, launch.err
        assert "high: its process ended by signal SIGKILL; it is started again" in launch.err
        assert launch.written[OUTLIVING].hex() == wanted
