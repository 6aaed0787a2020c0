"""Launch a deployment again and again: equal digests, nothing lost, nothing left behind.

    python benchmarks/launches.py --times 50 letters
    python benchmarks/launches.py --times 20 tracking -- --epochs 60

What stands behind `--` goes to `hierax run` (once, for the digest that all have to equal) and
to every `hierax launch`. Looks for processes, listening sockets and shared-memory segments
that were not there before, so nothing else of the kind should be running meanwhile. Exit code
1 where anything is not as it should be.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from commands import HIERAX

LISTENING = "0A"


def main() -> int:
    """Launch, compare, print a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("deployment")
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("options", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    options.options = [option for option in options.options if option != "--"]
    wanted = hierax("run", options.deployment, options.options)
    before = traces()
    starts_s, walls_s, faults = [], [], []
    for number in range(1, options.times + 1):
        begun = time.perf_counter()
        summary = hierax("launch", options.deployment, options.options)
        walls_s.append(time.perf_counter() - begun)
        starts_s.append(summary["start_s"])
        differing = [key for key in ("digest", "epochs") if summary[key] != wanted[key]]
        faults += [f"launch {number}: {key} {summary[key]}, not {wanted[key]}" for key in differing]
        faults += [f"launch {number}: left behind: {trace}" for trace in sorted(traces() - before)]
    print(f"{options.deployment}: {options.times} launches of {wanted['epochs']} epochs, digest {wanted['digest']}")
    print(f"start to first epoch  median {statistics.median(starts_s):.3f} s, longest {max(starts_s):.3f} s")
    print(f"whole command         median {statistics.median(walls_s):.3f} s, longest {max(walls_s):.3f} s")
    print("\n".join(faults) or "all digests equal that of `run`; no process, socket or segment left")
    return 1 if faults else 0


def hierax(mode: str, deployment: str, options: list[str]) -> dict[str, object]:
    """The summary of a run."""
    with tempfile.TemporaryDirectory() as folder:
        command = [*HIERAX, mode, deployment, "--output", folder, *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        summary: dict[str, object] = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
        return summary


def traces() -> set[str]:
    """What a launch could leave: node processes, listening TCP sockets, segments."""
    found = {f"segment {path}" for path in Path("/dev/shm").glob("*.zenoh")}
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        fields = [line.split() for line in Path(table).read_text(encoding="ascii").splitlines()[1:]]
        found |= {f"socket {line[1]}" for line in fields if line[3] == LISTENING}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # it has just ended
        if "launch.forking" in command:
            found.add(f"process {path.parent.name}: {command}")
    return found


if __name__ == "__main__":
    sys.exit(main())
