"""Kill, stop and resume launches of the tracking deployment: digests, acts, and what it costs.

    python benchmarks/kills.py                  # everything, about ten minutes
    python benchmarks/kills.py instants --times 5
    python benchmarks/kills.py random --kills 100 --seed 1
    python benchmarks/kills.py stops --times 5
    python benchmarks/kills.py supervisor --times 5
    python benchmarks/kills.py first --first 200
    python benchmarks/kills.py stopped --stopped 100
    python benchmarks/kills.py rates --rated 200

instants    each process kills itself at each named instant, `--times` times in one launch
random      processes are killed from outside, whenever and whichever it is
stops       a process is stopped (SIGSTOP) past the deadline of the epoch
supervisor  the supervisor is killed, and the run resumed
first       processes are killed from their first instant on, in servo, causal-tree and tracking
stopped     processes, the supervisor's too, are stopped for 0.1 to 5 s and go on, likewise
rates       processes are killed at random in deployments whose nodes have rates and delays

The deployment is deploy/tracking.yaml, simulated; its world has, but for `random`, a device
beside it, which logs the epochs in which it acts. Cost of a kill: how much later the next
epochs are committed than at the median pace, watched from outside. Exit code 1 where a digest
is not that of the undisturbed run, or the acts are not as promised.
"""

from __future__ import annotations

import argparse
import csv
import os
import random
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from links import kill_at_first, stop_and_go  # noqa: E402
from rated import kill_with_rates  # noqa: E402
from support.device_cubes import LOG  # noqa: E402
from support.device_nodes import acts  # noqa: E402
from support.faults import written  # noqa: E402
from support.launched import Launched, hierax, is_alive, until  # noqa: E402

EPOCHS = 60
NODES = ("world", "arm", "spatial")
RESTARTS = ("--set", "restart.max_restarts=0", "--set", "restart.restart_delay=0.0")
DEADLINE_S = 1.0
KILLS_PER_LAUNCH = 10

INSTANTS = {
    "world": ("keep", "send", "act", "intent", "acted", "commit"),
    "arm": ("save", "send 1", "send 2"),
    "spatial": ("save", "send"),
}
"""By node. The arm's first message goes up, its second one down."""
UNCERTAIN = {"intent.after": 0, "acted.before": 1}
"""Instants at which nobody knows whether the act was done; how often it was."""


def main() -> int:
    """Run the parts, print their tables."""
    parts: dict[str, Callable[[argparse.Namespace], list[str]]] = {
        "instants": kill_at_instants,
        "random": kill_at_random,
        "stops": stop_nodes,
        "supervisor": kill_supervisors,
        "first": kill_at_first,
        "stopped": stop_and_go,
        "rates": kill_with_rates,
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", choices=[*parts, []], metavar="PART")
    parser.add_argument("--times", type=int, default=5, help="per instant, and of stops and supervisors")
    parser.add_argument("--kills", type=int, default=100, help="at random")
    parser.add_argument("--first", type=int, default=200, help="kills in first instants")
    parser.add_argument("--stopped", type=int, default=100, help="stops after which processes go on")
    parser.add_argument("--rated", type=int, default=200, help="kills where nodes have rates and delays")
    parser.add_argument("--seed", type=int, default=1, help="of what happens when at random")
    options = parser.parse_args()
    faults = []
    for part in options.part or parts:
        faults += parts[part](options)
        print(flush=True)
    print("\n".join(faults) or "all digests are those of the undisturbed run, and all acts as promised")
    return 1 if faults else 0


# --- the parts


def kill_at_instants(options: argparse.Namespace) -> list[str]:
    """Each process in turn, at each of its instants."""
    faults: list[str] = []
    costs: list[float] = []
    wanted = undisturbed(with_device=True)
    print(f"{'node':8} {'instant':14} kills  cost median      max  digest  acts")
    for node, places in INSTANTS.items():
        for place in places:
            for side in ("before", "after"):
                spec = fault_of(node, place, side)
                with tempfile.TemporaryDirectory() as folder:
                    run = Run(Path(folder), True, faults=[spec] * options.times)
                    found = run.until_end()
                costs += found.costs(options.times)
                name = spec.split(":")[1]
                expected = Counter(range(1, EPOCHS + 1))
                for epoch in found.uncertain:
                    expected[epoch] += UNCERTAIN.get(name, 0)
                right = {
                    "digest": found.digest == wanted,
                    "kills": found.kills == options.times,
                    "acts": found.acts == expected,
                }
                faults += [f"{spec}: {what} {getattr(found, what)}" for what, each in right.items() if not each]
                said = "yes" if right["acts"] else "NO"
                said += f", {UNCERTAIN[name] + 1} in an uncertain epoch" if name in UNCERTAIN else ""
                what = f"{place}.{side}"
                print(
                    f"{node:8} {what:14} {found.kills:5} {table(found.costs(options.times))}"
                    f"  {'equal ' if right['digest'] else 'OTHER '}  {said}",
                    flush=True,
                )
    print(f"{len(costs)} kills: {table(costs)}")
    return faults


def kill_at_random(options: argparse.Namespace) -> list[str]:
    """Any process at any time, a quarter of them while another one is coming back."""
    rng = random.Random(options.seed)
    faults: list[str] = []
    costs: list[float] = []
    frames_are = "each once"
    wanted = undisturbed(with_device=False)
    left, kills = options.kills, Counter[str]()
    while left:
        with tempfile.TemporaryDirectory() as folder:
            run = Run(Path(folder), False)
            run.launch.until_epoch(2)
            run.kill_at_random(rng, min(left, KILLS_PER_LAUNCH))
            found = run.until_end()
            frames = frames_in(run.launch.output / "poses.csv")
        left -= len(run.victims)
        kills.update(run.victims)
        costs += run.group_costs(found.times)
        if found.digest != wanted:
            faults.append(f"random, seed {options.seed}: digest {found.digest}, not {wanted}")
        if found.kills != len(run.victims):
            faults.append(f"random, seed {options.seed}: {found.kills} ends noticed of {len(run.victims)}")
        if frames != list(range(EPOCHS)):
            faults.append(f"random, seed {options.seed}: poses of the frames {frames}")
            frames_are = "NOT each once"
    named = ", ".join(f"{name} {kills[name]}" for name in NODES)
    print(f"{kills.total()} kills at random ({named}): {table(costs)}; frames in poses.csv: {frames_are}")
    return faults


def stop_nodes(options: argparse.Namespace) -> list[str]:
    """SIGSTOP."""
    faults, named = [], []
    wanted = undisturbed(with_device=True)
    for number in range(options.times):
        node = NODES[number % len(NODES)]
        with tempfile.TemporaryDirectory() as folder:
            run = Run(Path(folder), True, "--set", f"epoch_deadline_s={DEADLINE_S}")
            run.launch.until_epoch(5 + number)
            os.kill(run.launch.until_pid(node), signal.SIGSTOP)
            since = time.monotonic()
            named.append(run.launch.until_said(f"{node}: its process is killed") - since)
            found = run.until_end()
        if found.digest != wanted or not found.acted_once:
            faults.append(f"{node} stopped: digest {found.digest}, acts {found.acts}")
    print(f"{len(named)} stops, deadline {DEADLINE_S:g} s: named after {table(named)}")
    return faults


def kill_supervisors(options: argparse.Namespace) -> list[str]:
    """SIGKILL, then --resume."""
    rng = random.Random(options.seed)
    faults, gone = [], []
    wanted = undisturbed(with_device=True)
    for _ in range(options.times):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            run = Run(folder, True)
            run.launch.until_epoch(rng.randrange(2, EPOCHS - 10))
            pids = [run.launch.until_pid(node) for node in NODES]
            run.launch.process.kill()
            gone.append(until(lambda pids=pids: not any(map(is_alive, pids)), "the nodes' end"))  # type: ignore[misc]
            found = Run(folder, True, "--resume", str(run.launch.state)).until_end()
        if found.digest != wanted or not found.acted_once:
            faults.append(f"supervisor killed, then resumed: digest {found.digest}, acts {found.acts}")
    print(f"{len(gone)} supervisors killed and resumed: nodes gone after {table(gone)}")
    return faults


# --- a launch


class Found:
    """What became of a launch.

    Attributes:
        digest: the last one.
        kills: how many processes the supervisor says were killed.
        acts: by epoch, how often the device moved.
        uncertain: the epochs of which nobody knew whether they were acted upon.
        times: when each epoch was seen to be committed, and how many then were.
    """

    def __init__(self, launch: Launched, log: Path, times: Sequence[tuple[float, int]]) -> None:
        self.digest = launch.report(timeout_s=300.0)["digest"]
        lines = [line for _, line in launch.said]
        self.kills = sum("by signal SIGKILL; it is started again" in line for line in lines)
        self.acts = Counter(acts(log))
        uncertain = [line.partition("the act of epoch ")[2].split()[0] for line in lines if "nobody knows" in line]
        self.uncertain = [int(epoch) for epoch in uncertain]
        self.times = times

    @property
    def acted_once(self) -> bool:
        """Whether every epoch was acted upon, and but for uncertain ones once."""
        certain = all(count == 1 or epoch in self.uncertain for epoch, count in self.acts.items())
        return certain and sorted(self.acts) == list(range(1, EPOCHS + 1))

    def costs(self, kills: int) -> list[float]:
        """Of kills of which each has held up another epoch: the longest ones, above the median."""
        lengths = sorted(lengths_of(self.times))
        return [length - statistics.median(lengths) for length in lengths[-kills:]]


class Run:
    """A launch whose commits are watched."""

    def __init__(self, folder: Path, with_device: bool, *options: str, faults: Sequence[str] = ()) -> None:
        self._log = folder / "device.log"
        os.environ[LOG] = str(self._log)
        begins = () if "--resume" in options else (deployment(folder, with_device), "--epochs", str(EPOCHS), *RESTARTS)
        os.environ.update(written(folder / "faults", faults) if faults else {})
        self.launch = Launched(folder, *begins, *options)
        self.victims: list[str] = []
        self._groups: list[list[float]] = []
        self._times: list[tuple[float, int]] = []
        self._watcher = threading.Thread(target=self._watch)
        self._watcher.start()

    def until_end(self) -> Found:
        """Wait for it."""
        self._watcher.join()
        return Found(self.launch, self._log, self._times)

    def kill_at_random(self, rng: random.Random, kills: int) -> None:
        """Kill any of its processes, so many times, or until it ends."""
        launch = self.launch
        while len(self.victims) < kills and launch.epoch < EPOCHS - 5:
            group: list[float] = []
            self._groups.append(group)
            self._kill(rng.choice(NODES), group)
            while rng.random() < 0.25 and len(self.victims) < kills:
                time.sleep(rng.random())
                self._kill(rng.choice(NODES), group)
            launch.until_epoch(launch.epoch + 2)
            time.sleep(rng.random() * 0.2)

    def _kill(self, node: str, group: list[float]) -> None:
        self.launch.kill(node)
        group.append(time.monotonic())
        self.victims.append(node)

    def group_costs(self, times: Sequence[tuple[float, int]]) -> list[float]:
        """By kill: how much later than at the median pace it went on, shared by the kills of a group."""
        pace = statistics.median(lengths_of(times))
        costs = []
        for number, group in enumerate(self._groups):
            end = self._groups[number + 1][0] if number + 1 < len(self._groups) else times[-1][0]
            since, first = max(each for each in times if each[0] <= group[0])
            until_s, last = max(each for each in times if each[0] <= end)
            costs += [(until_s - since - (last - first) * pace) / len(group)] * len(group)
        return costs

    def _watch(self) -> None:
        written, path = 0, self.launch.output / "digests.msgpack"
        while self.launch.running:
            size = path.stat().st_size if path.exists() else 0
            if size != written:
                written = size
                self._times.append((time.monotonic(), self.launch.epoch))
            time.sleep(0.002)


def undisturbed(with_device: bool) -> str:
    """The digest that all must come to."""
    with tempfile.TemporaryDirectory() as name:
        os.environ[LOG] = str(Path(name) / "device.log")
        digest: str = hierax("run", deployment(Path(name), with_device), "--epochs", str(EPOCHS))["digest"]
    return digest


def deployment(folder: Path, with_device: bool) -> str:
    """The tracking deployment, as it is or with a device."""
    path = ROOT / "deploy" / "tracking.yaml"
    if not with_device:
        return str(path)
    text, changed = path.read_text(encoding="utf-8"), folder / "tracking.yaml"
    world = "class: hierax.nodes.tracking.world:world\n"
    assert text.count(world) == 1
    changed.write_text(text.replace(world, "class: support.device_cubes:Actuated\n"), encoding="utf-8")
    return str(changed)


def fault_of(node: str, place: str, side: str) -> str:
    """In the third epoch of each process, or about: one that comes back writes a few records more."""
    name, _, which = place.partition(" ")
    sends = sum(each.startswith("send") for each in INSTANTS[node])
    number = {"send": 2 * sends + int(which or 1), "keep": 7}.get(name, 3)
    return f"{node}:{name}.{side}:{number}"


def frames_in(poses: Path) -> list[int]:
    """The frames of a BOP results file, in its order."""
    with poses.open(encoding="utf-8") as file:
        rows = Counter((int(row["im_id"]), int(row["obj_id"])) for row in csv.DictReader(file))
    doubled = {frame for (frame, _), count in rows.items() if count > 1}
    return sorted({frame for frame, _ in rows} - doubled)


def lengths_of(times: Sequence[tuple[float, int]]) -> list[float]:
    """From one commit that was seen to the next."""
    return [after - before for (before, _), (after, _) in pairwise(times)]


def table(seconds: Sequence[float]) -> str:
    """Median and maximum."""
    return f"{statistics.median(seconds):9.2f} s {max(seconds):6.2f} s"


if __name__ == "__main__":
    sys.exit(main())
