"""Files and answers made to harm who reads them, and what hierax says of each.

Run as ``python file_attacks.py FOLDER [NAME ...]``; it prints JSON: by attack, the line with which it was refused, how
many bytes the process grew by, and what came of it besides, which should be nothing.
"""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))

from hierax.runtime.commands.main import main as hierax  # noqa: E402
from support import malicious_answers  # noqa: E402
from support.deployments import TOYS  # noqa: E402
from support.junk_recordings import Contents  # noqa: E402
from support.malice import PRECIOUS, Attack, Place  # noqa: E402
from support.malicious_deployments import DEPLOYMENTS  # noqa: E402
from support.malicious_folders import FOLDERS, KEYS  # noqa: E402
from support.malicious_recordings import RECORDINGS  # noqa: E402

TIMEOUT_S = 60.0
ALLOWED_BYTES = 50 << 20

ATTACKS: dict[str, Attack] = {
    **{f"recording {name}": each for name, each in RECORDINGS.items()},
    **{f"folder {name}": each for name, each in FOLDERS.items()},
    **{f"deployment {name}": each for name, each in DEPLOYMENTS.items()},
    **{f"key {name}": each for name, each in KEYS.items()},
    **{f"answer: {name}": each for name, each in malicious_answers.ATTACKS.items()},
}


class Outcome(NamedTuple):
    """What an attack has come to."""

    line: str  # with which it was refused
    grown: int  # bytes that the process took more than one that does nothing
    seconds: float
    came: str  # of it, where that is not what should be


def tried(name: str, place: Place, floor: int) -> Outcome:
    """Make one, in a process of its own; floor: the bytes that one takes which does nothing."""
    attack = ATTACKS[name]
    precious = place.file("precious.json", PRECIOUS)
    arguments = attack.made(place)
    begun_s = time.monotonic()
    code, text, most = forked(arguments, place.folder)
    took_s = time.monotonic() - begun_s
    errors = [line for line in text.splitlines() if line.lower().startswith("error: ")]
    line = errors[0] if errors else ""
    faults = {
        f"it ends with {code}": code not in attack.codes,
        f"{len(errors)} lines of errors": len(errors) != (1 if code else 0),
        "a traceback": "Traceback" in text,
        "not the line expected": bool(errors) and attack.says not in line,
        "characters that move the cursor": re.search(r"[\x00-\x08\x0b-\x1f\x7f]", text) is not None,
        "code was run": any((place.folder / each).exists() for each in ("ran", "theirs/ran")),
        "another file was changed": not precious.exists() or precious.read_text() != PRECIOUS,
        f"{(most - floor) >> 20} MB": most - floor > ALLOWED_BYTES,
    }
    came = ", ".join(what for what, is_so in faults.items() if is_so)
    return Outcome(line if not came else text[-1500:], most - floor, took_s, came)


def forked(arguments: Sequence[str], folder: Path) -> tuple[int, str, int]:
    """Exit code, what is said, and the most bytes taken by a command in a process that knows all modules already."""
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        os.setpgid(0, 0)
        for stream in (1, 2):
            os.dup2(writing, stream)
        os.chdir(folder)
        os.environ["XDG_RUNTIME_DIR"] = str(folder)
        code = 3
        try:
            code = hierax(arguments)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    os.close(writing)
    text = _read_until(reading, time.monotonic() + TIMEOUT_S)
    with suppress(OSError):
        os.killpg(pid, signal.SIGKILL)
    _, status, used = os.wait4(pid, 0)
    return os.waitstatus_to_exitcode(status), text, used.ru_maxrss << 10


def _read_until(pipe: int, until_s: float) -> str:
    parts = []
    while select.select([pipe], [], [], max(until_s - time.monotonic(), 0.0))[0]:
        data = os.read(pipe, 1 << 16)
        if not data:
            break
        parts.append(data)
    os.close(pipe)
    return b"".join(parts).decode(errors="replace")


def attacked(folder: Path, *names: str) -> dict[str, Any]:
    """What comes of those that are named, or all, by name: the fields of each one's `Outcome`."""
    done = subprocess.run(
        [sys.executable, __file__, str(folder), *names], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def main() -> None:
    """Try those that are named, or all, and print what came of them."""
    folder = Path(sys.argv[1])
    os.environ.update(XDG_STATE_HOME=str(folder / "home"), PYTHONPATH=str(TESTS), RUST_LOG="off")
    deployment = folder / "toys.yaml"
    deployment.write_text(TOYS, encoding="utf-8")
    honest = folder / "honest.mcap"
    assert forked(("run", str(deployment), "--record", str(honest)), folder)[0] == 0
    place = Place(folder, deployment, Contents.read(honest))
    with subprocess.Popen(
        [sys.executable, malicious_answers.__file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as launches:
        assert launches.stdout is not None
        os.environ[malicious_answers.ENDPOINTS] = launches.stdout.readline()
        _, _, floor = forked(("replay", str(honest), "--verify"), folder)
        outcome = {}
        for number, name in enumerate(sys.argv[2:] or ATTACKS):
            own = folder / f"a{number}"
            own.mkdir(mode=0o700)
            outcome[name] = tried(name, place._replace(folder=own), floor)._asdict()
    json.dump(outcome, sys.stdout)


if __name__ == "__main__":
    main()
