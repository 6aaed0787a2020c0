"""Junk in everything that is read: no command answers it with a traceback, hangs or swells.

    python benchmarks/junk.py                         # all of it, some twenty minutes
    python benchmarks/junk.py --times 500 --seed 7

Read are recordings of shipped deployments, of which every field of metadata, roster, steps and messages is replaced by
others, left out, doubled, cut off; every command that reads recordings, on each.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from support.junk_recordings import Contents, Subject, faults, spoilt

from hierax.runtime.commands.main import main as hierax

SUBJECTS = {
    "letters": (4, ()),
    "servo": (6, ()),
    "chain": (4, ()),
    "causal-tree": (2, ("draw.sets=2",)),
    "tracking": (2, ("cubes=2", "frames=2")),
}
NODES = {"letters": "word", "servo": "camera", "chain": "arm", "causal-tree": "trunk", "tracking": "arm"}


def main() -> int:
    """Spoil, read, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=400, help="how many files of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--some", type=int, default=None, help="so many of the commands on each; by default all")
    parser.add_argument("--only", help="one deployment")
    options = parser.parse_args()
    print(f"seed {options.seed}")
    with tempfile.TemporaryDirectory(prefix="hierax-junk-") as folder:
        os.chdir(folder)
        return recordings(options.times, options.seed, options.some, options.only)


def recordings(times: int, seed: int, some: int | None, only: str | None) -> int:
    """Recordings with junk in them; how many commands did not end as they should."""
    wrong = 0
    told: Counter[str] = Counter()
    for name in SUBJECTS if only is None else (only,):
        subject = _subject(name)
        begun_s = time.monotonic()
        for number in range(times):
            random_ = random.Random(f"{seed} {name} {number}")
            path = Path("spoilt.mcap")
            what = spoilt(random_, subject.contents, path)
            for fault in faults(subject, path, random_, some):
                wrong += 1
                key = fault.text.strip().splitlines()[-2:]
                told[" / ".join(key)[-300:]] += 1
                if told[" / ".join(key)[-300:]] == 1:
                    print(
                        f"--- {name} {number} ({what}): {' '.join(fault.command)}: {fault.what}\n{fault.text}",
                        flush=True,
                    )
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{name}: {times} recordings, {time.monotonic() - begun_s:.0f} s, at most {peak:.0f} MB", flush=True)
    for key, count in told.most_common():
        print(f"{count:6} {key}")
    print(f"{wrong} wrong")
    return 1 if wrong else 0


def _subject(name: str) -> Subject:
    epochs, settings = SUBJECTS[name]
    file = Path(f"{name}.mcap").resolve()
    given = [part for each in settings for part in ("--set", each)]
    if hierax(["run", name, *given, "--epochs", str(epochs), "--record", str(file), "--format", "json"]):
        raise SystemExit(f"{name} cannot be recorded")
    return Subject(name, settings, file, Contents.read(file), NODES[name])


if __name__ == "__main__":
    sys.exit(main())
