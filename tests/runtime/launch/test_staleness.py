"""Launches with a staleness and in free running: changes, and processes that die."""

from __future__ import annotations

import json
import os
import random
import signal
from pathlib import Path
from typing import Any

import msgpack
import pytest
import yaml
from support.device_nodes import DEVICE, MOVES_S, acts
from support.launched import Launched, hierax, said_here
from support.pace import paced
from support.sweep import SWEEP

from hierax.runtime.deployment.deployment import shipped

MANY = "1000000"
AFTER = 20
NODES = ("arm", "eye", "spatial", "world")


# --- changes


class Changed:
    """A shipped deployment, launched at a measured pace with these fields, and changed while it runs."""

    def __init__(self, folder: Path, name: str, **fields: Any) -> None:
        plain = yaml.safe_load(shipped()[name].read_text(encoding="utf-8"))
        plain.pop("epochs", None)
        self._folder = folder
        self._nodes = {node: {"class": given["class"]} for node, given in plain["nodes"].items()}
        for node, given in plain["nodes"].items():  # a snippet knows no parameters of the file
            values = given.get("parameters", {})
            self._nodes[node]["parameters"] = {key: self._value(value, plain) for key, value in values.items()}
        self.paced = paced(folder, name, **fields)

    def launch(self, *options: str) -> Launched:
        return Launched(self._folder, self.paced, *options)

    def change(self, kind: str, *arguments: str) -> int:
        """Its first epoch."""
        done = said_here(kind, *arguments, "--format", "json", folder=self._folder)
        assert done.returncode == 0, done.stderr
        epoch: int = json.loads(done.stdout)["epoch"]
        return epoch

    def other(self, node: str) -> str:
        """A snippet that has a node in it as it is."""
        return str(self._write(f"{node}.yaml", {"nodes": {node: self._nodes[node]}}))

    def _value(self, value: Any, plain: Any) -> Any:
        if isinstance(value, list):
            return [self._value(each, plain) for each in value]
        if isinstance(value, str) and value.startswith("${"):
            return plain["parameters"][value[2:-1]]
        return value

    def _write(self, name: str, content: Any) -> Path:
        path = self._folder / name
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")  # whose order counts
        return path


@pytest.mark.parametrize("rates", [{}, {"world": 200.0, "spatial": 50.0}])
def test_nodes_that_run_freely_come_and_go(rates: dict[str, float], tmp_path: Path) -> None:
    changed = Changed(tmp_path, "chain", staleness=None)
    options = [option for node, rate in rates.items() for option in ("--set", f"nodes.{node}.rate_hz={rate}")]
    with changed.launch("--epochs", MANY, *options) as launch:
        launch.until_epoch(10)
        detached = changed.change("detach", "spatial")
        replaced = changed.change("replace", "arm", changed.other("arm"))
        attached = changed.change("attach", "spatial")
        assert 10 < detached < replaced < attached
        launch.until_epoch(attached + AFTER)
        launch.process.send_signal(signal.SIGTERM)
        launch.end()
        states = launch.output / "states"
        for node in ("world", "arm", "spatial"):
            with (states / f"{node}.msgpack").open("rb") as entries:
                done = [entry[0] for entry in msgpack.Unpacker(entries)]
            assert sorted(set(done)) == done
            assert attached - 1 in done or node == "spatial", "the epoch before a change is drained"
            assert attached in done, "and the first one after it"
        assert sorted(launch.written) == list(range(1, launch.epoch + 1))


def test_a_launch_that_runs_freely_ends_and_says_what_was_used() -> None:
    options = ["--set", "staleness=null", "--set", "nodes.world.rate_hz=200", "--set", "nodes.spatial.rate_hz=20"]
    report = hierax("launch", "chain", "--epochs", "100", *options)
    metrics = {name: node["metrics"] for name, node in report["nodes"].items()}
    assert report["epochs"] == 100
    assert report["wall_s"] > 0.4, "100 turns at 200 Hz"
    assert metrics["world"]["epochs_left_out"] == 0
    assert 30 < metrics["spatial"]["epochs_left_out"] < 99
    assert metrics["arm"]["staleness_max"] > 1


# --- processes that die


@pytest.mark.parametrize(
    ("seed", "fields"),
    [
        *([(1, "staleness: 1")] if SWEEP else []),
        (2, "staleness: 2"),
        (3, "staleness: 3"),
        (4, "staleness: null"),
    ],
)
def test_a_run_goes_on_when_processes_are_killed(
    seed: int, fields: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equal digests are not promised then; one act per epoch is."""
    epochs, kills = 250, 6
    monkeypatch.setenv(MOVES_S, "0.005")
    log, file = tmp_path / "device.log", tmp_path / "device.yaml"
    text = DEVICE.format(log=log, on_uncertain_act="skip", deadline_s=60.0, eye="")
    file.write_text(f"{text}{fields}\n", encoding="utf-8")
    rng = random.Random(seed)
    with Launched(tmp_path, str(file), "--epochs", str(epochs)) as launch:
        for node in [*NODES, *rng.choices(NODES, k=kills - len(NODES))]:
            launch.until_epoch(launch.epoch + rng.randrange(1, 20))
            launch.kill(node)
        report = launch.report()
        assert launch.err.count("by signal SIGKILL; it is started again") == kills, f"seed {seed}"
        assert sorted(launch.written) == list(range(1, epochs + 1))
    assert report["epochs"] == epochs
    done = acts(log)
    uncertain = launch.err.count("nobody knows whether the act")
    assert sorted(set(done)) == sorted(done), "no act is done twice"
    assert epochs - uncertain <= len(done) <= epochs, f"seed {seed}"


@pytest.mark.parametrize(
    ("staleness", "node"), [("2", "arm"), *([("2", "spatial")] if SWEEP else []), ("null", "spatial")]
)
def test_a_process_that_hangs_is_replaced(
    staleness: str, node: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In free running nobody waits for it, so that is found out when an epoch is drained, here the last one."""
    epochs = 200
    monkeypatch.setenv(MOVES_S, "0.005")
    log, file = tmp_path / "device.log", tmp_path / "device.yaml"
    text = DEVICE.format(log=log, on_uncertain_act="repeat", deadline_s=1.0, eye="")
    file.write_text(f"{text}staleness: {staleness}\n", encoding="utf-8")
    with Launched(tmp_path, str(file), "--epochs", str(epochs)) as launch:
        launch.until_epoch(10)
        pid = launch.until_pid(node)
        os.kill(pid, signal.SIGSTOP)
        launch.until_said(f"{node}: its process is killed: it does not answer in epoch")
        assert launch.report()["epochs"] == epochs
    assert acts(log) == list(range(1, epochs + 1))
