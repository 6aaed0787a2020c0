"""Large arrays through many epochs and kills: digests, memory, what is left behind.

    python benchmarks/arrays.py                                  # 100 000 epochs, some ten minutes
    python benchmarks/arrays.py --epochs 5000 --every 2 --seed 1

A chain of three nodes sends pictures up and down, in memory that its edge functions ask for and in memory of their own;
the upper two nodes keep some of the pictures beside their beliefs, more than may be lent. Every so many seconds a
process is killed, and once the supervisor, whose run is resumed. Told are the epochs, the kills, the most memory that
was lent, in all and to one process, and the most that a process had for itself, at the end beside the middle of the
run. Exit code 1 where the digest is not that of `hierax run`, where something is left in /dev/shm, or memory grew.
"""

import argparse
import os
import random
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.launched import Launched, hierax, is_alive, until  # noqa: E402
from support.picture_nodes import DEPLOYMENT, KEPT, lent_by  # noqa: E402

from hierax.runtime.transport.shared_arrays import SHARED_BYTES  # noqa: E402
from hierax.runtime.transport.zenoh_session import orphaned_segments  # noqa: E402

NODES = ("world", "low", "high")
GROWTH = 1.2  # what a process may have more at the end than in the middle of the run
LOOK_S = 0.25
NEAR = 100  # epochs before the end in which nobody is killed
TELLS_S = 20.0


class Watch:
    """What processes have, as it is looked at from time to time; in bytes."""

    def __init__(self) -> None:
        self.lent = self.lent_by_one = 0
        self._private: list[int] = []  # of the largest process, each time

    def look(self, launch: Launched) -> None:
        """Add what there is now."""
        pids = [pid for pid in map(launch.pid, NODES) if pid]
        spans: dict[str, int] = {}
        for pid in pids:
            mine = lent_by(pid)
            spans.update(mine)
            self.lent_by_one = max(self.lent_by_one, sum(mine.values()))
        self.lent = max(self.lent, sum(spans.values()))
        self._private.append(max(map(private, pids), default=0))

    @property
    def growth(self) -> float:
        """What the largest process has at the end, beside what it had in the middle."""
        quarter = len(self._private) // 4
        middle, end = max(self._private[quarter : 2 * quarter], default=1), max(self._private[-quarter:], default=1)
        return end / max(middle, 1)

    @property
    def private(self) -> int:
        """The most that one process had for itself."""
        return max(self._private, default=0)


def private(pid: int) -> int:
    """How many bytes a process has for itself; what it shares with others, and files, are not counted."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return next((1024 * int(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon")), 0)


def main() -> int:
    """Run it, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=100_000)
    parser.add_argument("--bytes", type=int, default=2_400_000, help="of a picture")
    parser.add_argument("--every", type=float, default=2.0, help="seconds between kills")
    parser.add_argument("--kept", type=int, default=60, help="pictures that each node but the world keeps")
    parser.add_argument("--seed", type=int, default=1, help="of the run, and of who is killed")
    options = parser.parse_args()
    os.environ[KEPT] = str(options.kept)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        deployment = folder / "pictures.yaml"
        deployment.write_text(DEPLOYMENT.format(size=options.bytes))
        arguments = (str(deployment), "--epochs", str(options.epochs), "--seed", str(options.seed))
        watch, kills, digest = launched(folder, arguments, options)
        os.environ[KEPT] = "0"
        wanted = hierax("run", *arguments)["digest"]
    until(lambda: not orphaned_segments(), "segments of Zenoh's are gone")
    left = [path.name for path in Path("/dev/shm").iterdir() if "hierax" in path.name]
    print(f"{options.epochs} epochs, {kills} kills, seed {options.seed}")
    print(f"lent: {watch.lent >> 20} MiB at most in all, {watch.lent_by_one >> 20} MiB mapped by one process")
    print(f"private: {watch.private >> 20} MiB at most in one process; at the end {watch.growth:.2f} times the middle")
    faults = {
        f"digest {digest}, not {wanted}": digest != wanted,
        f"left in /dev/shm: {left}": bool(left),
        f"memory grew by {watch.growth:.2f}": watch.growth > GROWTH,
        "more was lent than may be": watch.lent_by_one > 3 * (SHARED_BYTES + (1 << 20)),  # its own, and two neighbours'
    }
    found = [fault for fault, is_there in faults.items() if is_there]
    print("\n".join(found) or "the digest is that of one process, nothing is left, and memory does not grow")
    return 1 if found else 0


def launched(folder: Path, arguments: tuple[str, ...], options: argparse.Namespace) -> tuple[Watch, int, str]:
    """Launch, kill, resume; what was seen, the number of kills, and the run's digest."""
    watch, rng = Watch(), random.Random(options.seed)
    with Launched(folder, *arguments) as launch:
        kills = kill_on(launch, watch, rng, options, options.epochs // 2)
        pids = [launch.until_pid(node) for node in NODES]
        launch.process.kill()
        until(lambda: not any(map(is_alive, pids)), "the nodes' end")
    with Launched(folder, "--resume", str(folder / "state")) as launch:
        kills += kill_on(launch, watch, rng, options, options.epochs)
        return watch, kills, str(launch.report(timeout_s=600)["digest"])


def kill_on(launch: Launched, watch: Watch, rng: random.Random, options: argparse.Namespace, last: int) -> int:
    """Kill a process every so many seconds until an epoch is there, or the end is near; how many were killed."""
    kills, told_s = 0, time.monotonic()
    launch.until_epoch(launch.epoch + 1)  # before that, who resumes it may have the nodes' locks itself
    while launch.running and (epoch := launch.epoch) < last - NEAR:
        if time.monotonic() - told_s > TELLS_S:
            told_s = time.monotonic()
            print(f"epoch {epoch}, {kills} kills", file=sys.stderr, flush=True)
        until_s = time.monotonic() + options.every
        while time.monotonic() < until_s:
            watch.look(launch)
            time.sleep(LOOK_S)
        if launch.running and launch.epoch < last - NEAR:
            launch.kill(rng.choice(NODES))
            kills += 1
    return kills


if __name__ == "__main__":
    sys.exit(main())
