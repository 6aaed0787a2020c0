"""Recordings of launches: whole under crashes and changes, there after a kill, and what they cost.

    python benchmarks/recordings.py                      # everything, some ten minutes
    python benchmarks/recordings.py deployments servo    # one deployment
    python benchmarks/recordings.py kills --times 20 --seed 1
    python benchmarks/recordings.py overhead tracking --epochs 300 --rounds 5

deployments  each shipped deployment is launched and recorded; every kind of process is killed, the top node is
             detached and attached again; then `replay --verify` with the world done again, and `check`
kills        the recorder of a launch is killed (SIGKILL) at a random instant: its file has to open, and to have all
             that was committed more than a chunk's time before
overhead     launches with and without a recorder in turn: the median epoch, and what lacks
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from commands import HIERAX

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import shipped
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.host.run_secret import read_key
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.writing import CHUNK_S
from hierax.runtime.transport.launch_client import LaunchClient

TIMEOUT_S = 120.0
SETTINGS = {"tracking": ("frames=100000", "cubes=3"), "pick": ("frames=100000",)}
"""With which a deployment goes on for as long as it is let."""

MANY = "1000000"
SLACK_S = 0.5
"""Beyond a chunk's time: how long what is committed may take to be in a chunk on a busy machine."""


class Launch:
    """A launch under way, in a folder of its own."""

    def __init__(self, folder: Path, name: str, *options: str) -> None:
        self.folder = folder
        self.settings = [part for setting in SETTINGS.get(name, ()) for part in ("--set", setting)]
        self.environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
        command = [*HIERAX, "launch", name, *self.settings, "--output", str(folder / "out"), *options]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self.environment
        )

    def hierax(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """What a command says."""
        return subprocess.run(
            [*HIERAX, *arguments], capture_output=True, text=True, timeout=TIMEOUT_S, env=self.environment, check=False
        )

    @property
    def run(self) -> dict[str, Any]:
        """What is known of it."""
        (file,) = (self.folder / "hierax").glob("*.json")
        endpoint = json.loads(file.read_text(encoding="utf-8"))["endpoint"]
        with LaunchClient(endpoint, secret=read_key(file.with_suffix(".key"))) as client:
            return client.ask({"ask": "ps"})

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until a condition holds."""
        begun = time.monotonic()
        while not condition():
            if self.process.poll() is not None:
                raise RuntimeError(f"it has ended: {self.process.communicate()[1]}")
            if time.monotonic() - begun > TIMEOUT_S:
                raise RuntimeError(f"not within {TIMEOUT_S:g} s: {what}")
            time.sleep(0.02)

    def go_on(self, epochs: int = 5) -> None:
        """Let some epochs be committed."""
        before = self.run["epoch"]
        self.wait_for(lambda: self.run["epoch"] >= before + epochs, f"{epochs} epochs")

    def kill(self, name: str) -> None:
        """Kill a node's process, and wait for the next one."""
        node = self.run["nodes"][name]
        os.kill(node["pid"], signal.SIGKILL)
        self.wait_for(lambda: self.run["nodes"].get(name, node)["instance"] != node["instance"], f"{name} again")
        self.go_on()

    def end(self) -> tuple[int, str]:
        """End it; its exit code and what it said."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        _, said = self.process.communicate(timeout=TIMEOUT_S)
        return self.process.returncode, said


@contextmanager
def launched(name: str, *options: str) -> Iterator[Launch]:
    """A launch that has committed its first epochs."""
    with tempfile.TemporaryDirectory(prefix="hierax-bench-") as folder:
        launch = Launch(Path(folder), name, *(option.replace("FOLDER", folder) for option in options))
        try:
            launch.wait_for(lambda: bool(list((launch.folder / "hierax").glob("*.json"))), "the launch")
            launch.wait_for(lambda: launch.run["epoch"] > 2, "the first epochs")
            yield launch
        finally:
            launch.end()


def main() -> int:
    """Run the parts, print their tables."""
    parts = {"deployments": record_deployments, "kills": kill_recorders, "overhead": measure}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=[*parts])
    parser.add_argument("names", nargs="*", metavar="DEPLOYMENT")
    parser.add_argument("--times", type=int, default=20, help="of kills")
    parser.add_argument("--seed", type=int, default=1, help="of their instants")
    parser.add_argument("--epochs", type=int, default=300, help="of each launch of overhead")
    parser.add_argument("--rounds", type=int, default=5, help="of overhead")
    options = parser.parse_args()
    faults: list[str] = []
    for part in [options.part] if options.part else parts:
        faults += parts[part](options)
        print(flush=True)
    print("\n".join(faults) or "all as it must be")
    return 1 if faults else 0


# --- deployments


def record_deployments(options: argparse.Namespace) -> list[str]:
    """Each deployment with crashes and changes in it."""
    print(f"{'deployment':14} {'epochs':>7} {'deaths':>6} {'changes':>7} {'redone':>6}  verify, check")
    faults = []
    for name in options.names or sorted(shipped()):
        faults += _attempted(name)
    return faults


def _attempted(name: str) -> list[str]:
    try:
        return _record_deployment(name)
    except (RuntimeError, HieraxError) as error:
        return [f"{name}: {error}"]


def _record_deployment(name: str) -> list[str]:
    with launched(name, "--record", "FOLDER/run.mcap", "--check", "--epochs", MANY) as launch:
        file = launch.folder / "run.mcap"
        changes = deaths = 0
        for victim in _kinds(name):
            launch.kill(victim)
            deaths += 1
        top = _kinds(name)[-1]
        for change in (("detach", top, "--cascade"), ("attach", top)):
            done = launch.hierax(*change)
            if done.returncode:
                raise RuntimeError(f"{' '.join(change)}: {done.stderr.strip()}")
            changes += 1
            launch.go_on()
        launch.kill(top)
        deaths += 1
        code, said = launch.end()
        faults = [] if code == 130 else [f"{name}: launch: exit code {code}: {said}"]
        faults += [f"{name}: {line}" for line in said.splitlines() if "not recorded" in line or "broken" in line]
        verified = launch.hierax("replay", str(file), "--verify", "--world", "again")
        checked = launch.hierax("check", str(file))
        faults += [
            f"{name}: {each.args[4]}: {each.stdout}{each.stderr}" for each in (verified, checked) if each.returncode
        ]
        epochs = list(Recording.open(file).epochs())
        redone = sum(epoch.attempt > 0 for epoch in epochs)
        says = f"{verified.stdout.splitlines()[-1]}; {checked.stdout.strip().rpartition(': ')[2]}"
        print(f"{name:14} {len(epochs):7} {deaths:6} {changes:7} {redone:6}  {says}", flush=True)
    return faults


def _kinds(name: str) -> list[str]:
    """The world, one in the middle, one that has nothing above it."""
    roster = read_deployment(name).roster
    tops = [each for each in sorted(roster.nodes) if not roster.above(each)]
    middle = [each for each in sorted(roster.nodes) if each != roster.world and each not in tops]
    return [roster.world, *middle[:1], tops[-1]]


# --- kills


def kill_recorders(options: argparse.Namespace) -> list[str]:
    """A recorder is killed at a random instant, again and again."""
    print(f"{'kill':>4} {'after s':>8} {'MB':>6} {'whole epochs':>13} {'committed before':>17}  said")
    drawn = random.Random(options.seed)
    faults = []
    with launched((options.names or ["tracking"])[0], "--epochs", MANY) as launch:
        for number in range(options.times):
            fault = _kill_recorder(launch, number, drawn.uniform(CHUNK_S + SLACK_S, 4.0))
            faults += [fault] if fault else []
    return faults


def _kill_recorder(launch: Launch, number: int, after_s: float) -> str:
    file = launch.folder / f"{number}.mcap"
    recorder = subprocess.Popen(
        [*HIERAX, "record", "-o", str(file)], stderr=subprocess.PIPE, text=True, env=launch.environment
    )
    assert recorder.stderr is not None
    recorder.stderr.readline()  # it listens
    launch.wait_for(lambda: file.stat().st_size > 20_000, "something recorded")
    time.sleep(after_s - CHUNK_S - SLACK_S)
    before = launch.run["epoch"]
    time.sleep(CHUNK_S + SLACK_S)
    recorder.kill()
    recorder.wait()
    recorder.stderr.close()
    recording = Recording.open(file)
    whole = [epoch.epoch for epoch in recording.epochs() if not epoch.lacking]
    verified = launch.hierax("replay", str(file), "--verify", "--to", str(whole[-1]))
    unbroken = whole == list(range(whole[0], whole[-1] + 1))
    size_mb = file.stat().st_size / 1e6
    print(
        f"{number:4} {after_s:8.2f} {size_mb:6.2f} {whole[0]:6}-{whole[-1]:6} {before:17}  {recording.loss}", flush=True
    )
    file.unlink()
    if verified.returncode or not unbroken or whole[-1] < before or not recording.loss:
        return f"kill {number}: {whole[0]} to {whole[-1]} whole, {before} committed: {verified.stdout}{verified.stderr}"
    return ""


# --- overhead


def measure(options: argparse.Namespace) -> list[str]:
    """The median epoch with and without a recorder, in turn."""
    print(
        f"{'deployment':12} {'p50 µs bare':>12} {'recorded':>9} {'ratio':>6} {'of rounds':>16} {'MB/epoch':>9}  lacking"
    )
    faults = []
    for name in options.names or ["tracking", "servo", "chain"]:
        bare, recorded, lacking, size = [], [], 0, 0.0
        for _ in range(options.rounds):
            bare.append(_timed(name, options.epochs)[0])
            p50, lost, bytes_per_epoch = _timed(name, options.epochs, record=True)
            recorded.append(p50)
            lacking += lost
            size = bytes_per_epoch
        ratios = sorted(with_it / without for with_it, without in zip(recorded, bare, strict=True))
        print(
            f"{name:12} {statistics.median(bare):12.0f} {statistics.median(recorded):9.0f} "
            f"{statistics.median(ratios):6.2f} {ratios[0]:7.2f} to {ratios[-1]:5.2f} {size / 1e6:9.3f}  {lacking}",
            flush=True,
        )
        faults += [f"{name}: {lacking} things lack"] if lacking else []
    return faults


def _timed(name: str, epochs: int, record: bool = False) -> tuple[float, int, float]:
    with tempfile.TemporaryDirectory(prefix="hierax-bench-") as folder:
        file = Path(folder) / "run.mcap"
        settings = [part for setting in SETTINGS.get(name, ()) for part in ("--set", setting)]
        options = ["--record", str(file)] if record else []
        command = [*HIERAX, "launch", name, *settings, "--epochs", str(epochs), "--format", "json", *options]
        environment = {**os.environ, "XDG_RUNTIME_DIR": folder}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if done.returncode and not record:
            raise RuntimeError(done.stderr)
        p50 = float(json.loads(done.stdout)["epoch_us"]["p50"])
        if not record:
            return p50, 0, 0.0
        ending = Recording.open(file).ending
        lost = 1 if ending is None else ending.lost
        return p50, lost, file.stat().st_size / epochs


if __name__ == "__main__":
    sys.exit(main())
