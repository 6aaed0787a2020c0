"""Launches whose processes are killed, stopped and cut off: the digests of the undisturbed run, and one act per epoch.

What is looked at comes from outside: the processes by their checkpoints' locks, commits
by the digests that are written, acts by the device's own log.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import msgpack
import pytest
from support.device_nodes import DEVICE, HOLDS_UP, MOVES_S, acts
from support.faults import written
from support.launched import Command, Launched, is_alive, processes_of, run_here, until
from support.recompute_digest import main as recompute_digest

EPOCHS = 40
NODES = ("arm", "eye", "spatial", "world")
GONE_S = 2.0
DEADLINE_S = 1.0
NAMED_S = 0.5
MOVE_S = 0.005

PLACES = {
    "world": ("keep", "send", "act", "intent", "acted", "commit"),
    "arm": ("save", "send"),
    "spatial": ("save", "send"),
    "eye": ("save",),
}
"""Where a node can be killed."""


class Device:
    """A deployment whose world moves a device, and what the undisturbed run of it comes to."""

    def __init__(self, folder: Path, environment: pytest.MonkeyPatch) -> None:
        self._folder = folder
        self._environment = environment
        self.log = folder / "device.log"
        self.file = str(folder / "device.yaml")

    def write(self, on_uncertain_act: str = "repeat", deadline_s: float = 60.0, eye: str = "") -> None:
        text = DEVICE.format(log=self.log, on_uncertain_act=on_uncertain_act, deadline_s=deadline_s, eye=eye)
        Path(self.file).write_text(text, encoding="utf-8")

    def digest(self, epochs: int, *options: str) -> str:
        """Of the run in one process; the log begins anew after it."""
        self._environment.delenv(MOVES_S, raising=False)
        digest: str = run_here(self.file, "--epochs", str(epochs), *options)["digest"]
        self.log.unlink()
        return digest

    def launch(self, epochs: int, *options: str, moves_s: float = 0.0, faults: Sequence[str] = ()) -> Launched:
        self._environment.setenv(MOVES_S, str(moves_s))
        for name, value in written(self._folder / "faults", faults).items() if faults else ():
            self._environment.setenv(name, value)
        return Launched(self._folder, self.file, "--epochs", str(epochs), *options)


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Device:
    return Device(tmp_path, monkeypatch)


@pytest.mark.parametrize("node", PLACES)
def test_a_process_may_be_killed_at_every_instant(node: str, device: Device) -> None:
    """One process after the other is killed at the next instant, at its second or third time."""
    device.write()
    wanted = device.digest(EPOCHS)
    faults = [f"{place}.{side}:{2 + n % 2}" for n, place in enumerate(PLACES[node]) for side in ("before", "after")]
    with device.launch(EPOCHS, faults=[f"{node}:{fault}" for fault in faults]) as launch:
        report = launch.report()
        assert launch.err.count(f"{node}: its process ended by signal SIGKILL; it is started again") == len(faults)
        assert sorted(launch.written) == list(range(1, EPOCHS + 1))
        for name in NODES:
            rows = msgpack.Unpacker(io.BytesIO((launch.output / "states" / f"{name}.msgpack").read_bytes()))
            assert sorted({row[0] for row in rows}) == list(range(1, EPOCHS + 1)), f"the states of {name}"
        assert recompute_digest([str(launch.output)]) == 0
    assert report["digest"] == wanted
    assert report["epochs"] == EPOCHS
    assert sorted(set(acts(device.log))) == list(range(1, EPOCHS + 1))


@pytest.mark.parametrize(
    ("policy", "before_it", "after_it"),
    [("repeat", 1, 2), ("skip", 0, 1)],
)
def test_an_uncertain_act_is_repeated_or_skipped(policy: str, before_it: int, after_it: int, device: Device) -> None:
    """The world is killed before one act, and after another; how often each was done then."""
    device.write(on_uncertain_act=policy)
    wanted = device.digest(10)
    with device.launch(10, faults=["world:intent.after:4", "world:acted.before:3"]) as launch:
        assert launch.report()["digest"] == wanted
        uncertain = re.findall(r"nobody knows whether the act of epoch (\d+) was done", launch.err)
    first, second = map(int, uncertain)
    assert first == 4 < second
    times = {first: before_it, second: after_it}
    assert acts(device.log) == [epoch for epoch in range(1, 11) for _ in range(times.get(epoch, 1))]


@pytest.mark.parametrize("seed", [1])
def test_processes_may_be_killed_at_random(seed: int, device: Device) -> None:
    epochs, kills = 300, 8
    device.write()
    wanted = device.digest(epochs)
    rng = random.Random(seed)
    with device.launch(epochs, moves_s=MOVE_S) as launch:
        for _ in range(kills):
            launch.until_epoch(launch.epoch + rng.randrange(1, 20))
            launch.kill(rng.choice(NODES))
        report = launch.report()
        assert launch.err.count("by signal SIGKILL; it is started again") == kills, f"seed {seed}"
    assert report["digest"] == wanted, f"seed {seed}"
    assert sorted(set(acts(device.log))) == list(range(1, epochs + 1))


def test_a_process_that_somebody_ends_kindly_is_lost_all_the_same(device: Device) -> None:
    device.write()
    epochs = 4 * EPOCHS
    wanted = device.digest(epochs)
    with device.launch(epochs, moves_s=MOVE_S) as launch:
        for node in ("arm", "world"):
            launch.until_epoch(launch.epoch + 3)
            pid = launch.until_pid(node)
            os.kill(pid, signal.SIGTERM)
            assert launch.until_pid(node, other_than=pid)
        assert launch.report()["digest"] == wanted
        for node in ("arm", "world"):
            assert launch.err.count(f"{node}: its process ended with exit code 1; it is started again") == 1


def test_a_run_goes_on_when_all_of_it_was_killed(device: Device) -> None:
    epochs = 150
    device.write()
    wanted = device.digest(epochs)
    with device.launch(epochs, moves_s=MOVE_S) as launch:
        launch.until_epoch(20)
        pids = [launch.until_pid(name) for name in NODES]
        launch.process.kill()
        assert until(lambda: not any(map(is_alive, pids)), "the nodes' end") < GONE_S
        state = launch.state
    done = acts(device.log)
    assert done == list(range(1, len(done) + 1))
    assert 20 <= len(done) < epochs
    with Launched(state.parent, "--resume", str(state)) as launch:
        report = launch.report()
    assert report["digest"] == wanted
    assert report["epochs"] == epochs
    assert acts(device.log) == list(range(1, epochs + 1)), "nodes end when an epoch does, so no act is uncertain"


def stop(pid: int) -> float:
    """Stop a process, as if it hung; when that was."""
    os.kill(pid, signal.SIGSTOP)
    return time.monotonic()


def test_a_process_that_hangs_is_named_and_replaced(device: Device) -> None:
    epochs = 250
    device.write(deadline_s=DEADLINE_S)
    wanted = device.digest(epochs)
    with device.launch(epochs, moves_s=MOVE_S) as launch:
        for node in ("arm", "world"):
            launch.until_epoch(launch.epoch + 10)
            pid = launch.until_pid(node)
            since = stop(pid)
            named = launch.until_said(f"{node}: its process is killed: it does not answer")
            assert named - since < DEADLINE_S + NAMED_S
            launch.until_said(f"{node}: its process ended by signal SIGKILL; it is started again")
            assert launch.until_pid(node, other_than=pid)
        assert launch.report()["digest"] == wanted
    assert sorted(set(acts(device.log))) == list(range(1, epochs + 1))


@pytest.mark.parametrize("policy", ["restart_policy: never", "rejoin_timeout: 0.01"])
def test_a_process_that_hangs_is_detached(
    policy: str, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once; or when the one that is started in its place does not come up in time."""
    epochs = 100
    holds_up = tmp_path / "holds up"
    monkeypatch.setenv(HOLDS_UP, str(holds_up))
    device.write(deadline_s=DEADLINE_S, eye=f", {policy}, on_loss: detach")
    with device.launch(epochs, moves_s=MOVE_S) as launch:
        launch.until_epoch(10)
        holds_up.touch()
        stop(launch.until_pid("eye"))
        launch.until_said("it is detached (on_loss)")
        report = launch.report()
    assert sorted(report["nodes"]) == ["arm", "spatial", "world"]
    assert report["epochs"] == epochs
    assert acts(device.log) == list(range(1, epochs + 1))


def test_a_process_that_hangs_ends_the_run(device: Device) -> None:
    device.write(deadline_s=DEADLINE_S, eye=", restart_policy: never, on_loss: stop")
    with device.launch(100_000, moves_s=MOVE_S) as launch:
        launch.until_epoch(10)
        pids = [launch.until_pid(name) for name in NODES]
        stop(launch.until_pid("eye"))
        launch.end()
        assert launch.process.returncode == 1
        assert launch.err.splitlines()[-1].startswith("error: eye: ")
    assert not any(map(is_alive, pids))


SNIPPET = """\
nodes:
  ear: {class: "support.device_nodes:Guesser", rejoin_timeout: 0.2, on_loss: detach}
edges:
  world -> ear: {sense: "support.device_nodes:place"}
"""


def test_a_process_that_was_taken_for_lost_is_refused(device: Device, tmp_path: Path) -> None:
    """Its keeper is stopped with it, as on a machine that is cut off; both go on later, and the run until they have."""
    device.write(deadline_s=DEADLINE_S)
    snippet = tmp_path / "ear.yaml"
    snippet.write_text(SNIPPET, encoding="utf-8")
    with device.launch(100_000, moves_s=MOVE_S) as launch:
        launch.until_epoch(10)
        with Command(tmp_path, "attach", str(snippet), "--here") as keeper:
            until(lambda: bool(keeper.printed) or not keeper.running, "the attachment")
            found = re.findall("^attached ear at epoch ([0-9]+)\n$", "".join(keeper.printed))
            assert found, (keeper.err, launch.err)
            (attached,) = found
            (ear,) = processes_of(keeper.process.pid)
            keeper.process.send_signal(signal.SIGSTOP)
            since = stop(ear)
            assert launch.until_said("ear: its process") - since < DEADLINE_S + NAMED_S
            launch.until_said("it is detached (on_loss)")
            launch.until_epoch(launch.epoch + 10)
            keeper.process.send_signal(signal.SIGCONT)
            os.kill(ear, signal.SIGCONT)
            keeper.until_said("ear: its process exits: ear: ")
            keeper.end()
            assert keeper.process.returncode == 0
            assert not is_alive(ear)
        assert launch.running
        launch.process.send_signal(signal.SIGINT)
        report = json.loads(launch.end())
        assert launch.process.returncode == 130, launch.err
    epochs = report["epochs"]
    (lost,) = re.findall("ear: its process is lost in epoch ([0-9]+)", launch.err)
    changes = ["--at", f"{attached}:attach:{snippet}", "--at", f"{lost}:detach:ear"]
    assert acts(device.log) == list(range(1, epochs + 1))
    assert report["digest"] == device.digest(epochs, *changes)
