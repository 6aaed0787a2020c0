"""How long a launch takes to its first epoch, and what memory its processes have, beside ones that start by themselves.

    python benchmarks/start.py                 # five rounds in turn, a minute
    python benchmarks/start.py --rounds 3 --chain 64

letters     `hierax launch letters` (five nodes): seconds that it tells to the first epoch, from when it has read what
            it needs itself; seconds from the command's start on until it has ended, after three epochs; and private
            memory of a process of a node that needs no cv2, the median, in MB (what no other process shares)
chain of N  the same of a chain of N nodes that do nothing
plain       as many processes of Python as letters has nodes, each of which imports numpy, msgpack and Zenoh and opens a
            session; seconds until all have
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from commands import at_least  # noqa: E402
from growth import hierarchy  # noqa: E402
from support.launched import HIERAX, Command, processes_of, until  # noqa: E402

PLAIN = "import msgpack, numpy, sys, zenoh; s = zenoh.open(zenoh.Config()); print(flush=True); sys.stdin.read()"
LETTERS_NODES = 5


def main() -> int:
    """Launch in turn, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=at_least(1), default=5)
    parser.add_argument("--chain", type=at_least(2), default=64, help="nodes of the chain")
    options = parser.parse_args()
    letters_s, chain_s, plain_s, whole_s = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        chain = Path(folder) / "chain.yaml"
        hierarchy("chain", options.chain, start_timeout_s=120.0).to_yaml(chain)
        for _ in range(options.rounds):
            begun = time.perf_counter()
            letters_s.append(ours("letters"))
            whole_s.append(time.perf_counter() - begun)
            plain_s.append(plain(LETTERS_NODES))
            chain_s.append(ours(str(chain)))
        private_mb = memory(Path(folder))
    first = statistics.median(plain_s)
    for name, seconds in (("letters", letters_s), ("plain", plain_s), (f"chain of {options.chain}", chain_s)):
        median = statistics.median(seconds)
        print(f"{name:12} {median:6.2f} s ({min(seconds):.2f} to {max(seconds):.2f}), {median / first:5.2f} × plain")
    print(f"the whole command, letters: {statistics.median(whole_s):.2f} s ({min(whole_s):.2f} to {max(whole_s):.2f})")
    print(f"a node's process: {private_mb:.1f} MB of its own")
    return 0


def ours(deployment: str) -> float:
    """Seconds that a launch tells to its first epoch."""
    command = [*HIERAX, "launch", deployment, "--epochs", "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = re.search(r"start to first epoch: (\S+) s", done.stdout)
    if found is None:
        raise SystemExit(f"{deployment}: the launch failed: {done.stderr.strip()}")
    return float(found[1])


def plain(count: int) -> float:
    """So many processes that open a session each; seconds until all have."""
    begun = time.perf_counter()
    started = [
        subprocess.Popen([sys.executable, "-c", PLAIN], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for _ in range(count)
    ]
    for each in started:
        assert each.stdout is not None
        each.stdout.readline()
    took_s = time.perf_counter() - begun
    for each in started:
        each.communicate()
    return took_s


def memory(folder: Path) -> float:
    """MB that a process of a node of letters has for itself, while it runs."""
    with Command(folder, "launch", "letters", "--epochs", "100000") as launch:
        until(lambda: len(processes_of(launch.process.pid)) >= LETTERS_NODES, "all processes")
        time.sleep(3.0)
        return statistics.median(map(private_mb, processes_of(launch.process.pid)))


def private_mb(pid: int) -> float:
    """What no other process shares."""
    rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return sum(int(kb) for kb in re.findall(r"Private_(?:Clean|Dirty):\s+(\d+)", rollup)) / 1024


if __name__ == "__main__":
    sys.exit(main())
