"""What `hierax export compose` and `systemd` write, started by podman and by systemd: the digests of `hierax run`.

    podman build --file deploy/Containerfile --tag hierax .
    podman build --file benchmarks/booted.Containerfile --tag hierax-booted .
    python benchmarks/containers.py
    python benchmarks/containers.py --run-args="--ulimit nofile=1024:1024"    # where `podman run` needs some

Needs podman, podman-compose (PyPI), and the images. `letters` is brought up once, and its container then finds its run
over. `servo` is brought up, asked for its health within its container, killed, and brought up again: it goes on with
its run. Then systemd runs in a container of its own, and the user's service that is written for it: asked for its
health, killed with all its processes, and started again by systemd. Exit code 1 where a digest is another one, where
one does not go on, or a container is not what its file says: somebody without capabilities whose root filesystem is
read-only.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from commands import HIERAX

DIGEST = re.compile(r"digest: ([0-9a-f]{64})")
EPOCH = re.compile(r"epoch (\d+)")
CONFINED = ("Uid:\t10001\t", "CapEff:\t0000000000000000", "NoNewPrivs:\t1")
EPOCHS, KILLED_AT = 40_000, 15_000
UP_S = 300.0
BOOTED, UNIT = "hierax-booted", "hierax-servo"


def main() -> int:
    """Bring both up, and tell of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run-args", default="", help="for every `podman run`")
    options = parser.parse_args()
    for program in ("podman", "podman-compose"):
        if shutil.which(program) is None:
            parser.error(f"there is no `{program}`; expected it to be installed")
    for image in ("hierax", BOOTED):
        if subprocess.run(["podman", "image", "exists", image], check=False).returncode:
            parser.error(f"there is no image `{image}`; expected it to be built as is said above")
    with tempfile.TemporaryDirectory() as name:
        sound = [_letters(Composed(Path(name) / "a", "letters", 200, options.run_args))]
        servo = Composed(Path(name) / "b", "servo", EPOCHS, options.run_args)
        sound += [_servo(servo), _as_a_unit(servo.digest, options.run_args)]
    return 0 if all(sound) else 1


class Composed:
    """A deployment as a Compose file."""

    def __init__(self, folder: Path, name: str, epochs: int, run_args: str) -> None:
        self.name, self._folder, self._run_args = name, folder, run_args
        given = ("--seed", "3", "--epochs", str(epochs))
        _said([*HIERAX, "export", "compose", name, "-o", str(folder), *given])
        self.digest: str = json.loads(_said([*HIERAX, "run", name, *given, "--format", "json"]))["digest"]
        self.container = f"hierax-{name}_hierax-{name}_1"

    def up(self) -> str:
        """What it says until it ends."""
        return self._compose("up")

    def start(self) -> None:
        """Bring it up, and go on."""
        said = self._compose("up", "--detach")
        if DIGEST.search(said) or self.inside("true").returncode:
            raise AssertionError(f"{self.container} does not run: {said}")

    def down(self) -> None:
        """Remove it, with its volume."""
        self._compose("down", "--volumes")

    def epoch(self, least: int) -> int:
        """Its epoch, by its health, as soon as that is so great."""
        return _until(least, lambda: self.inside("hierax", "health", "--run", self.name).stdout)

    def end(self) -> str:
        """What it has said, when it has ended."""
        _said(["podman", "wait", self.container])
        return subprocess.run(["podman", "logs", self.container], capture_output=True, text=True, check=True).stdout

    def inside(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run something in its container."""
        return subprocess.run(["podman", "exec", self.container, *command], capture_output=True, text=True, check=False)

    def _compose(self, *arguments: str) -> str:
        command = ["podman-compose", f"--podman-run-args={self._run_args}", *arguments]
        done = subprocess.run(
            command,
            cwd=self._folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=UP_S,
            check=False,
        )
        return done.stdout


def _letters(letters: Composed) -> bool:
    try:
        equal = letters.digest in DIGEST.findall(letters.up())
        over = "the run is over" in letters.up()
    finally:
        letters.down()
    print(
        f"letters: digest {'equal' if equal else 'ANOTHER ONE'}, {'over' if over else 'NOT OVER'} when brought up again"
    )
    return equal and over


def _servo(servo: Composed) -> bool:
    try:
        servo.start()
        before = servo.epoch(KILLED_AT)
        writes = [servo.inside("touch", path).returncode == 0 for path in ("/x", "/opt/hierax/x", "/tmp/x", "/state/x")]
        status = servo.inside("cat", "/proc/1/status").stdout
        confined = writes == [False, False, True, True] and all(each in status for each in CONFINED)
        _said(["podman", "kill", servo.container])
        servo.start()
        went_on = servo.epoch(1) >= before  # one that had begun anew would not be there yet
        equal = servo.digest in DIGEST.findall(servo.end())
    finally:
        servo.down()
    print(f"servo: {'confined' if confined else f'NOT CONFINED: {writes}, {status}'}", end=", ")
    print(f"killed after epoch {before}, and {'went on' if went_on else 'DID NOT GO ON'}", end=", ")
    print(f"digest {'equal' if equal else 'ANOTHER ONE'}")
    return confined and went_on and equal


def _as_a_unit(digest: str, run_args: str) -> bool:
    name = f"{BOOTED}-{os.getpid()}"
    booted = ["--detach", "--network", "none", "--systemd=always", "--privileged", "--name", name, BOOTED]
    _said(["podman", "run", *run_args.split(), *booted])

    def inside(command: str) -> str:
        home = ["--env", "HOME=/root", "--env", "XDG_RUNTIME_DIR=/run/user/0", "--env", "XDG_STATE_HOME="]
        done = subprocess.run(
            ["podman", "exec", *home, name, "sh", "-c", command], capture_output=True, text=True, check=False
        )
        return done.stdout

    try:
        inside("until systemctl start user@0; do sleep 0.2; done")
        given = f"--seed 3 --epochs {EPOCHS}"
        inside(f"cd /root && hierax export systemd servo -o units {given} && systemctl --user link /root/units/*")
        inside(f"systemctl --user enable --now {UNIT}")
        before = _until(KILLED_AT, lambda: inside("hierax health --run servo"))
        healthy = inside(f"systemctl --user start {UNIT}-health && echo healthy")
        inside(f"systemctl --user kill --signal=KILL {UNIT}")
        went_on = _until(1, lambda: inside("hierax health --run servo")) >= before
        restarts = inside(f"systemctl --user show --property NRestarts {UNIT}")
        state = inside(
            f"while systemctl --user is-active --quiet {UNIT}; do sleep 0.5; done; systemctl --user is-failed {UNIT}"
        )
        summary = json.loads(inside("cat $(find / -xdev -path '*/hierax-servo/output/summary.json')"))
    finally:
        subprocess.run(["podman", "rm", "--force", name], stdout=subprocess.PIPE, check=False)
    again = "NRestarts=1" in restarts and went_on and "healthy" in healthy and "inactive" in state
    equal = summary["digest"] == digest
    print(
        f"servo by systemd: killed after epoch {before}, {'and went on' if again else f'{restarts} {healthy} {state}'}",
        end=", ",
    )
    print(f"digest {'equal' if equal else 'ANOTHER ONE'}")
    return again and equal


def _until(least: int, health: Callable[[], str]) -> int:
    """The epoch of a launch, by its health, as soon as that is so great."""
    until_s = time.monotonic() + UP_S
    while time.monotonic() < until_s:
        found = EPOCH.search(health())
        if found and int(found[1]) >= least:
            return int(found[1])
    raise AssertionError(f"no epoch {least} within {UP_S:g} s")


def _said(command: list[str]) -> str:
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


if __name__ == "__main__":
    sys.exit(main())
