"""Two parts of `kills.py`: processes killed in their first instants, and processes stopped for a while.

Both in launches of `servo`, `causal-tree` and `tracking`, with no deadline of epochs: nothing but the processes
themselves makes a run go on.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import statistics
import tempfile
import time
from pathlib import Path

from support.launched import Launched, hierax, processes_of, until

ROOT = Path(__file__).resolve().parents[1]
EPOCHS = {"servo": 4_000, "causal-tree": 2_000, "tracking": 60}
OPTIONS = ("epoch_deadline_s=null", "restart.max_restarts=0", "restart.restart_delay=0.0")
FIRST_S = 0.6
"""For how long after its start a process is killed."""
STOPS_S = (0.1, 5.0)
RATE = 0.7
"""Of the processes that start, how many are killed."""
PER_LAUNCH = 7
TIMEOUT_S = 60.0


def kill_at_first(options: argparse.Namespace) -> list[str]:
    """Processes from the first instant of theirs on, also those that come in the place of such."""
    rng = random.Random(options.seed)
    faults: list[str] = []
    for name, wanted in _undisturbed().items():
        kills, left = 0, -(-options.first // len(EPOCHS))
        while kills < left:
            with tempfile.TemporaryDirectory() as folder:
                launch = _launch(Path(folder), name)
                kills += _kill_those_that_start(launch, rng, min(PER_LAUNCH, left - kills))
                faults += _fault(launch, name, wanted, f"killed at first, seed {options.seed}")
        print(f"{name:12} {kills} kills within {FIRST_S:g} s of a process's start", flush=True)
    return faults


def stop_and_go(options: argparse.Namespace) -> list[str]:
    """SIGSTOP, and SIGCONT after a while: of one process, several, or the supervisor."""
    rng = random.Random(options.seed)
    faults: list[str] = []
    all_waits: list[float] = []
    for name, wanted in _undisturbed().items():
        waits: list[float] = []
        left = -(-options.stopped // len(EPOCHS))
        while len(waits) < left:
            with tempfile.TemporaryDirectory() as folder:
                launch = _launch(Path(folder), name)
                launch.until_epoch(2)
                while len(waits) < left and launch.running and launch.epoch < EPOCHS[name] * 0.8:
                    wait = _stop(launch, rng)
                    if wait is not None:
                        waits.append(wait)
                faults += _fault(launch, name, wanted, f"stopped, seed {options.seed}")
        all_waits += waits
        print(f"{name:12} {len(waits)} stops: the next epoch after {_table(waits)}", flush=True)
    print(f"{'all':12} {len(all_waits)} stops: the next epoch after {_table(all_waits)}")
    return faults


def _launch(folder: Path, name: str) -> Launched:
    settings = [part for option in OPTIONS for part in ("--set", option)]
    return Launched(folder, str(ROOT / "deploy" / f"{name}.yaml"), "--epochs", str(EPOCHS[name]), *settings)


def _undisturbed() -> dict[str, str]:
    return {
        name: hierax("run", str(ROOT / "deploy" / f"{name}.yaml"), "--epochs", str(epochs))["digest"]
        for name, epochs in EPOCHS.items()
    }


def _fault(launch: Launched, name: str, wanted: str, what: str) -> list[str]:
    epoch = -1
    while launch.running and launch.epoch > epoch:  # a machine that others use may be slow
        epoch = launch.epoch
        until(lambda: launch.epoch > epoch or not launch.running, f"an epoch after {epoch}\n{launch.err}")  # noqa: B023
    launch.end()
    digest = launch.written.get(EPOCHS[name], b"").hex()
    if launch.process.returncode == 0 and digest == wanted:
        return []
    return [f"{name} {what}: exit code {launch.process.returncode}, digest {digest}, not {wanted}\n{launch.err}"]


def _kill_those_that_start(launch: Launched, rng: random.Random, most: int) -> int:
    """How many were killed."""
    due: dict[int, float] = {}
    seen: set[int] = set()
    kills = 0
    while launch.running:
        now = time.monotonic()
        for pid in processes_of(launch.process.pid):
            if pid not in seen:
                seen.add(pid)
                if kills + len(due) < most and rng.random() < RATE:
                    due[pid] = now + rng.uniform(0.0, FIRST_S)
        for pid in [pid for pid, at_s in due.items() if now >= at_s]:
            del due[pid]
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue  # it has ended by itself
            kills += 1
        time.sleep(0.001)
    return kills


def _stop(launch: Launched, rng: random.Random) -> float | None:
    """Seconds from SIGCONT to the next epoch that is written; None where the run was over before that."""
    here = processes_of(launch.process.pid)
    everybody = [launch.process.pid, *here]
    pids = rng.sample(everybody, rng.choice((1, 1, 1, 2, len(everybody))))
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(rng.uniform(*STOPS_S))
    epoch = launch.epoch
    for pid in pids:
        os.kill(pid, signal.SIGCONT)
    waited = until(lambda: launch.epoch > epoch or not launch.running, f"an epoch after {epoch}", TIMEOUT_S)
    return waited if launch.epoch > epoch else None


def _table(seconds: list[float]) -> str:
    return f"{statistics.median(seconds):.2f} s (median), {max(seconds):.2f} s (longest)"
