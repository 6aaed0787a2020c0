"""Change running hierarchies, again and again: nothing is lost, and what a change costs.

    python benchmarks/changes.py
    python benchmarks/changes.py --changes 20 --seed 7 servo

Launches `letters`, `servo` and a random hierarchy of 12 nodes, and attaches, detaches and
replaces nodes of each while it runs as fast as it can, with the commands that a user has. Each
launch is then repeated by `hierax run` with the same changes `--at` the epochs that the commands
have named: the last digest, which covers all epochs before, has to be the same.

A change's cost is the time that the last epoch before it and the first one under it took together,
from commit to commit, less two ordinary epochs (the median of the same launch): all that holds an
epoch up, but not the start of the new process, which the hierarchy does not wait for. Beside it
stands how much longer the 21 epochs around it took in all, where that start, the end of the old
process and the opening of links show as load on the processor; and both for places without a
change, as others have the processor now and then.

Exit code 1 where an epoch or digest is not as it should be, or a change costs more at the median
than `--limit-ms`.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from commands import HIERAX, reported
from random_changes import KINDS, Subject, next_change, snippet, subject

from hierax.runtime.commands.main import main as hierax_main
from hierax.runtime.core.probe import Probe, Step
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.owner.owner import OVER
from hierax.schemas.roster import Attach, Change, Detach

HIERARCHIES = ("letters", "servo", "random")
EPOCHS = {"letters": 20_000, "servo": 40_000, "random": 4_000}
"""Of one launch."""

LAST_CHANGE = 0.7
"""At this share of a launch's epochs no more changes are asked for, so that none is overtaken by its end."""

TIMES = "commits.npy"
START_TIMEOUT_S = 60.0
PAUSE_S = 0.1
"""After each change, as what asks for the next one, and its start, would be taken for a part of this one's cost."""
NONE = "no change"
AROUND = 10
"""Epochs on either side of one that are looked at, too."""


class RunOverError(Exception):
    """The launch came to its end before a change could be made."""


class CommitTimes(Probe):
    """Keeps when the world was done with each epoch; part of the deployment, not of the run."""

    def __init__(self) -> None:
        self._times_s: list[float] = []
        self._path = Path(os.devnull)

    def open(self, output: Path | None) -> None:
        self._path = Path(os.environ["HIERAX_COMMIT_TIMES"])

    def record(self, step: Step) -> None:
        self._times_s.append(time.perf_counter())

    def close(self) -> None:
        np.save(self._path, np.array(self._times_s))


@dataclass
class Result:
    """What launches of one hierarchy have come to.

    Attributes:
        launches, epochs: how many.
        changes: how many were made.
        costs_ms: by kind of change, its cost and that of the epochs around it; `NONE`: of places without one. A change
            whose neighbours aren't all epochs of its launch isn't among them: the hierarchy ran on while it was made.
        faults: what is not as it should be.
    """

    launches: int = 0
    epochs: int = 0
    changes: int = 0
    costs_ms: dict[str, list[tuple[float, float]]] = field(
        default_factory=lambda: {kind: [] for kind in (*KINDS, NONE)}
    )
    faults: list[str] = field(default_factory=list)


class Launch:
    """One launch, changed while it runs, then repeated in one process."""

    def __init__(self, subject: Subject, seed: int, epochs: int, folder: Path, result: Result) -> None:
        self._subject = subject
        self._epochs = epochs
        self._seed = seed
        self._folder = folder
        self._result = result
        self._rng = random.Random(f"{subject.name}/{seed}")
        self._file = folder / f"{subject.name}.yaml"
        probe = {"node": subject.plain["world"], "class": f"{Path(__file__).stem}:CommitTimes"}
        self._file.write_text(yaml.safe_dump({**subject.plain, "probes": [probe]}), encoding="utf-8")
        self._made: list[tuple[str, int, str]] = []

    def go(self, limit: int) -> None:
        """Launch, change at most so many times, compare."""
        launched = subprocess.Popen(
            [*HIERAX, "launch", "--format", "json", *self._words()],
            env=self._environment(TIMES),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._wait_until_up(launched)
        self._change(limit)
        out, err = launched.communicate()
        if launched.returncode:
            raise SystemExit(f"{self._place}: the launch failed: {err.strip()}")
        self._compare(json.loads(out))
        self._time()

    @property
    def _place(self) -> str:
        return f"{self._subject.name}, seed {self._seed}"

    def _words(self) -> list[str]:
        return [str(self._file), "--epochs", str(self._epochs), "--seed", str(self._seed)]

    def _environment(self, times: str) -> dict[str, str]:
        here = str(Path(__file__).resolve().parent)
        paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
        return {**os.environ, "PYTHONPATH": paths, "HIERAX_COMMIT_TIMES": str(self._folder / times)}

    def _wait_until_up(self, launched: subprocess.Popen[str]) -> None:
        patience = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < patience and launched.poll() is None:
            runs = json.loads(hierax("ps", "--format", "json"))["runs"]
            if runs and runs[0]["epoch"] > AROUND + 2:  # else there is nothing before the first change to be timed
                return
            time.sleep(0.05)
        raise SystemExit(f"{self._place}: the launch did not come up: {launched.communicate()[1]}")

    def _change(self, limit: int) -> None:
        first = roster = read_deployment(self._file).roster
        last = self._epochs * LAST_CHANGE
        epoch = 0
        while len(self._made) < limit and epoch < last:
            kind, change, roster = next_change(self._rng, self._subject, first, roster)
            arguments, schedule = self._spell(kind, change)
            try:
                epoch = json.loads(hierax(kind, *arguments, "--format", "json"))["epoch"]
            except RunOverError:
                return  # refused, so it did not take effect
            self._made.append((kind, epoch, f"{epoch}:{schedule}"))
            time.sleep(PAUSE_S)

    def _spell(self, kind: str, change: Change) -> tuple[list[str], str]:
        """A change as a command's arguments, and as ``--at`` has it."""
        if isinstance(change, Detach):
            return [change.name, "--cascade"], f"detach:{change.name}:cascade"
        file = str(self._folder / f"change{len(self._made)}.yaml")
        if isinstance(change, Attach):
            content, arguments, spelled = snippet(change.nodes, change.edges), [file], f"attach:{file}"
        else:
            content = {"nodes": snippet({change.name: change.reference}, ())["nodes"]}
            arguments, spelled = [change.name, file], f"replace:{change.name}:{file}"
        Path(file).write_text(yaml.safe_dump(content), encoding="utf-8")
        return arguments, spelled

    def _compare(self, summary: dict[str, Any]) -> None:
        at = [argument for _, _, spelled in self._made for argument in ("--at", spelled)]
        failed = f"{self._place}: the repetition failed"
        wanted = reported(failed, "run", *self._words(), *at, environment=self._environment("run.npy"))
        for key in ("digest", "epochs", "nodes"):
            if summary[key] != wanted[key]:
                self._result.faults.append(f"{self._place}: {key} of launch and run differ; changes: {at}")
        self._result.launches += 1
        self._result.changes += len(self._made)
        self._result.epochs += summary["epochs"]

    def _time(self) -> None:
        times_s = np.load(self._folder / TIMES)
        if len(times_s) != self._epochs:
            self._result.faults.append(f"{self._place}: {len(times_s)} epochs were told to the probe")
            return
        ordinary_s = float(np.median(np.diff(times_s)))

        def longer_ms(first: int, last: int) -> float:
            """How much longer these epochs took than as many ordinary ones."""
            return 1e3 * float(times_s[last - 1] - times_s[first - 2] - (last - first + 1) * ordinary_s)

        def costs_ms(epoch: int) -> tuple[float, float]:
            return longer_ms(epoch - 1, epoch), longer_ms(epoch - AROUND, epoch + AROUND)

        changed = {epoch for _, epoch, _ in self._made}
        inner = range(AROUND + 2, len(times_s) - AROUND)
        for kind, epoch, _ in self._made:
            if epoch in inner:
                self._result.costs_ms[kind].append(costs_ms(epoch))
        far = [epoch for epoch in inner[:: 2 * AROUND] if not changed.intersection(range(epoch - 20, epoch + 21))]
        self._result.costs_ms[NONE] += map(costs_ms, far)


def hierax(*arguments: str) -> str:
    """What a command prints, in this process: its start would take longer than what it asks for."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = hierax_main(arguments)
    if code:
        if err.getvalue().strip() == f"error: {OVER}":
            raise RunOverError
        raise SystemExit(f"hierax {' '.join(arguments)}: {err.getvalue().strip()}")
    return out.getvalue()


def show(name: str, result: Result) -> None:
    """A hierarchy's lines of the table."""
    for kind, costs in result.costs_ms.items():
        if costs:
            figures = np.percentile(costs, (50, 95, 100), axis=0)
            cells = " ".join(f"{figure:9.2f}" for column in figures.T for figure in column)
            print(f"{name:8} {kind:10} {len(costs):6} {cells}", flush=True)


def main() -> int:
    """Launch, change, compare, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("hierarchies", nargs="*", metavar="HIERARCHY", help=f"of {', '.join(HIERARCHIES)}; all")
    parser.add_argument("--changes", type=int, default=200, help="of each hierarchy")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--epochs", type=int, help="of each launch")
    parser.add_argument("--limit-ms", type=float, default=20.0, help="of the median cost of a change")
    options = parser.parse_args()
    unknown = sorted(set(options.hierarchies) - set(HIERARCHIES))
    if unknown:
        parser.error(f"there is no hierarchy {unknown[0]!r}")
    with tempfile.TemporaryDirectory(prefix="hierax-changes-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder  # other launches are none of ours
        return compare(options)


def compare(options: argparse.Namespace) -> int:
    """All hierarchies that were asked for; the exit code."""
    headings = ("median", "p95", "max")
    print(f"{'':26} {'cost, ms':^29} {'with 10 epochs on either side, ms':^29}")
    print(f"{'':8} {'change':10} {'count':>6} {' '.join(f'{heading:>9}' for heading in headings * 2)}")
    faults = []
    for name in options.hierarchies or HIERARCHIES:
        result = Result()
        seed = options.seed
        while result.changes < options.changes:
            with tempfile.TemporaryDirectory() as folder:
                launch = Launch(subject(name, seed), seed, options.epochs or EPOCHS[name], Path(folder), result)
                launch.go(options.changes - result.changes)
            seed += 1
        show(name, result)
        faults += result.faults
        costs_ms = [cost for kind in KINDS for cost, _ in result.costs_ms[kind]]
        if costs_ms and statistics.median(costs_ms) > options.limit_ms:
            faults.append(f"{name}: a change costs {statistics.median(costs_ms):.1f} ms at the median")
        made = f"{result.changes} changes in {result.launches} launches, {result.epochs} epochs"
        print(f"{name:8} {made}: {'NOT as scheduled' if result.faults else 'digests equal those of the scheduled run'}")
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
