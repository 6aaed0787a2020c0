"""Launch hierarchies over three hosts, lose one, cut a link: the digests are those of one process.

    python benchmarks/hosts.py                # letters and tracking, some minutes; root, iproute2, openssh-server
    python benchmarks/hosts.py ctrl-c         # how long Ctrl-C takes alone, half a minute

Hosts are network namespaces with an `sshd` in each; what is sent between them takes 2 ms, and 1 % of the packets are
lost (`tests/support/wire.py`). Exit code 1 where a digest is another one, or Ctrl-C takes too long.
"""

import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.far_hosts import ARM, DESK, ROBOT, FarHosts  # noqa: E402
from support.live import HIERAX, Program, environment, hierax, until  # noqa: E402

LOST_S, CUT_S = 2, 5.0
ENDS_S = 2.0  # what README says of Ctrl-C
PRESSES = 5
PLACES = {
    "letters": (300, {"world": ROBOT, "letter1": ARM, "letter2": ROBOT, "word": DESK}),
    "tracking": (60, {"world": ROBOT, "arm": ARM, "spatial": DESK}),
}
"""By hierarchy, how many epochs, and where its nodes run; the rest is on the desk."""

ROBOT_LOST, ARM_CUT = "robot lost", f"arm cut off for {CUT_S:g} s"
SAID = {ROBOT_LOST: (f"host {ROBOT} is lost", f"is on host {DESK}, as {ROBOT} is lost")}
"""By way, what the launch has to say of it; a link that is cut is told by the time that it takes."""

Disturb = Callable[[FarHosts], object]


def main() -> int:
    """Launch, disturb, and tell of it."""
    sound = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        far = FarHosts(folder)
        try:
            for hierarchy, (epochs, place) in PLACES.items():
                if sys.argv[1:] != ["ctrl-c"]:
                    sound &= launched(far, folder, hierarchy, epochs, place)
                sound &= interrupted(far, folder, hierarchy, place)
        finally:
            far.remove()
    return 0 if sound else 1


def launched(far: FarHosts, folder: Path, hierarchy: str, epochs: int, place: dict[str, str]) -> bool:
    """One hierarchy, in all ways; whether all digests are equal."""
    placed = placed_file(far, folder, hierarchy, place)
    arguments = ("--epochs", str(epochs), "--format", "json")
    wanted = json.loads(hierax(folder, "run", str(placed), *arguments).stdout)["digest"]
    ways: list[tuple[str, str, Disturb]] = [
        ("on the desk", hierarchy, lambda _: None),
        ("on three hosts", str(placed), lambda _: None),
        (ROBOT_LOST, str(placed), lambda far: far.power_off(ROBOT)),
        (ARM_CUT, str(placed), lambda far: far.cut_for(ARM, CUT_S)),
    ]
    sound = True
    for way, file, disturb in ways:
        begun_s = time.monotonic()
        program = Program(("launch", file, *arguments), environment(folder), far.namespaces[DESK])
        until(lambda process=program.process: process.poll() is not None or committed(far, folder) > epochs // 10)
        disturbed = program.process.poll() is None
        disturb(far)
        assert program.ends() == 0, program.err
        report: dict[str, Any] = json.loads("".join(program.out))
        program.kill()
        equal = report["digest"] == wanted
        missed = [part for part in SAID.get(way, ()) if not any(part in line for line in program.err)]
        sound &= equal and disturbed and not missed
        if not disturbed:
            print("    it was over before anything happened", flush=True)
        for part in missed:
            print(f"    nothing was said of: {part}", flush=True)
        took = f"{time.monotonic() - begun_s:.1f} s, epoch p50 {report['epoch_us']['p50'] / 1e3:.1f} ms"
        print(f"{hierarchy}, {way}: {took}, digest {'equal' if equal else 'ANOTHER ONE'}", flush=True)
        for line in program.err:
            print(f"    {line.rstrip()}", flush=True)
        if way == ROBOT_LOST:
            far.power_on(ROBOT)
    return sound


def interrupted(far: FarHosts, folder: Path, hierarchy: str, place: dict[str, str]) -> bool:
    """Ctrl-C, some times, on three hosts: whether all is gone in time, with the digest of so many epochs."""
    placed = placed_file(far, folder, hierarchy, place)
    exits_s, ends_s, equal = [], [], True
    for _ in range(PRESSES):
        arguments = ("launch", str(placed), "--epochs", "1000000", "--format", "json")
        program = Program(arguments, environment(folder), far.namespaces[DESK])
        until(lambda: committed(far, folder) > 1)
        program.process.send_signal(signal.SIGINT)
        signalled_s = time.monotonic()
        program.process.wait()
        exits_s.append(time.monotonic() - signalled_s)
        until(lambda: far.is_idle(ROBOT) and far.is_idle(ARM), "the end of the keepers")
        ends_s.append(time.monotonic() - signalled_s)
        assert program.ends() == 130, program.err
        report = json.loads("".join(program.out))
        program.kill()
        again = ("run", str(placed), "--epochs", str(report["epochs"]), "--format", "json")
        equal &= json.loads(hierax(folder, *again).stdout)["digest"] == report["digest"]
    times = ", ".join(
        f"{what} {statistics.median(each):.2f} s (longest {max(each):.2f} s)"
        for what, each in (("its exit", exits_s), ("the end of all processes", ends_s))
    )
    in_time = max(ends_s) < ENDS_S
    late = "" if in_time else f", NOT WITHIN {ENDS_S:g} s"
    print(f"{hierarchy}, Ctrl-C on three hosts, {PRESSES} times: {times}{late}, ", end="")
    print(f"digest {'equal' if equal else 'ANOTHER ONE'}", flush=True)
    return equal and in_time


def placed_file(far: FarHosts, folder: Path, hierarchy: str, place: dict[str, str]) -> Path:
    """Its deployment file, with nodes on hosts."""
    told = (ROOT / "deploy" / f"{hierarchy}.yaml").read_text(encoding="utf-8")
    hosts = far.hosts(robot=f"fallback: desk, lost_after: {LOST_S}", arm="lost_after: 30")
    placed = folder / f"{hierarchy}.yaml"
    placed.write_text(f"{told}\n{hosts}place: {json.dumps(place)}\n", encoding="utf-8")
    return placed


def committed(far: FarHosts, folder: Path) -> int:
    """The last epoch of the launch on the desk; 0 before the first."""
    command = ["ip", "netns", "exec", far.namespaces[DESK], *HIERAX, "ps", "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(folder), check=False)
    runs = json.loads(done.stdout)["runs"] if done.returncode == 0 else []
    return int(runs[0]["epoch"]) if runs else 0


if __name__ == "__main__":
    sys.exit(main())
