"""Ctrl-C at random instants of commands: a line or nothing, and no traceback.

    python benchmarks/interrupts.py                       # all of them, some five minutes
    python benchmarks/interrupts.py --times 5 --seed 3 top "logs -f"

The signal goes to all processes of the command, as a terminal has it. Instants before the console script has begun are
Python's own and counted apart, with the latest of them: nobody else can answer there.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from support.launched import TESTS, environment
from support.live import Live

COMMANDS = (
    "--version",
    "run servo --epochs 1000000",
    "launch servo --epochs 1000000",
    "top",
    "view",
    "record live --overwrite -o FOLDER/live.mcap",
    "logs -f",
    "echo **",
    "attach --here FOLDER/more.yaml",
)
ENDS_S = 20.0
LATEST = 1.5
"""Until when the signal comes, as a multiple of what it takes `--version` to end."""

SCRIPT = str(Path(sys.executable).with_name("hierax"))
OURS = (str(TESTS.parent / "runtime"), "hierax/runtime", "zenoh")
"""One of these stands in a traceback of ours."""
OWN_START = "in Python's own start"
EXPECTED = {0, 130, -signal.SIGINT}


def main() -> int:
    """Press, read, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", default=COMMANDS)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"seed {options.seed}")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` has it ignored, by all that is started
    chance = random.Random(options.seed)
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="hierax-interrupts-") as name:
        folder = Path(name)
        os.environ["XDG_STATE_HOME"] = name
        live = Live(folder)
        try:
            longest_s = _time_of_version(folder)
            for command in options.commands:
                wrong += _sweep(command, options.times, longest_s, chance, live)
        finally:
            live.close()
    return 1 if wrong else 0


def _time_of_version(folder: Path) -> float:
    begun_s = time.monotonic()
    subprocess.run([*_words("--version", folder)], env=environment(folder), stdout=subprocess.DEVNULL, check=True)
    return time.monotonic() - begun_s


def _words(command: str, folder: Path) -> list[str]:
    return [sys.executable, SCRIPT, *command.replace("FOLDER", str(folder)).split()]


def _sweep(command: str, times: int, longest_s: float, chance: random.Random, live: Live) -> int:
    """How often a command answered otherwise than in a line."""
    outcomes: Counter[str] = Counter()
    wrong, latest_s = 0, 0.0
    for number in range(times):
        # each attaches a node of its own, as the one before may not be gone yet
        if "attach" in command:
            os.replace(live.snippet(f"more{number}", "low"), live.folder / "more.yaml")
        delay_s = chance.uniform(0.0, longest_s * (1.0 if command == "--version" else 1.0 + LATEST))
        code, out, err = _pressed(_words(command, live.folder), delay_s, live.folder)
        outcome = _outcome(code, err)
        outcomes[outcome] += 1
        if outcome == OWN_START:
            latest_s = max(latest_s, delay_s)
        if outcome.startswith("wrong"):
            wrong += 1
            print(f"{command} after {delay_s:.3f} s, exit code {code}:\n{out[-500:]}\n{err[-3000:]}")
    said = [f"{count} {what}" for what, count in outcomes.most_common()]
    print(f"{command}: {', '.join(said)}, {OWN_START} {1000 * latest_s:.0f} ms at the latest", flush=True)
    return wrong


def _pressed(words: list[str], delay_s: float, folder: Path) -> tuple[int | None, str, str]:
    process = subprocess.Popen(
        words,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**environment(folder), "XDG_STATE_HOME": str(folder)},
        cwd=TESTS,
        start_new_session=True,
    )
    time.sleep(delay_s)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    try:
        out, err = process.communicate(timeout=ENDS_S)
        return process.returncode, out, err
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        return None, out, err


def _outcome(code: int | None, err: str) -> str:
    lines = [line for line in err.splitlines() if not line.startswith("hierax: ")]
    if "Traceback" in err or "KeyboardInterrupt" in err:
        return OWN_START if not any(ours in err for ours in OURS) else "wrong: a traceback"
    if code is None:
        return f"wrong: no end within {ENDS_S:g} s"
    if code not in EXPECTED or len(lines) > 1:
        return f"wrong: exit code {code}, {len(lines)} lines"
    return f"with exit code {code} and {len(lines) or 'no'} lines"


if __name__ == "__main__":
    sys.exit(main())
