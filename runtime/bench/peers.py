"""`hierax bench peers`: the chain of three processes beside what users would pick instead."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from hierax.runtime.bench.bare_chain import LOW_LATENCY, ORDINARY, SHARED
from hierax.runtime.bench.epoch import PICTURE_BYTES, TIMEOUT_S, Times, bare, counted, ours
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.report import Json
from hierax.runtime.host.streams import python_code

SMALL, LARGE = "small messages", f"{PICTURE_BYTES / 1e6:g} MB in the context"
WORK = {SMALL: 0, LARGE: PICTURE_BYTES}  # bytes of the picture
LOAD = 2  # busy loops
ZENOH = {SMALL: (ORDINARY, LOW_LATENCY), LARGE: (ORDINARY, SHARED)}
HIERAX = {SMALL: (ORDINARY, LOW_LATENCY), LARGE: (ORDINARY,)}
RIVALS = {"ezmsg": ("ezmsg", "rivals"), "dora": ("dora", "rivals"), "ROS 2": ("ros2", "ros")}  # module, environment

Run = Callable[[int, int], Sequence[float]]
"""By the number of epochs and the bytes of the picture: how long epochs took, in microseconds."""


@dataclass
class Peer:
    """One of those that do the work: for each round, the counted epochs, in microseconds; why there are none."""

    name: str
    run: Run
    missing: str = ""
    rounds_us: list[Times] = field(default_factory=list)

    def plain(self, others: Sequence["Peer"]) -> dict[str, Json]:
        """Give it as plain JSON, with ratios to others: the median of those of the rounds' medians."""
        if self.missing:
            return {"name": self.name, "missing": self.missing}
        p50, p99 = (float(each) for each in np.percentile(np.concatenate(self.rounds_us), (50, 99)))
        own = [np.median(each) for each in self.rounds_us]
        ratios = {
            other.name: float(
                np.median([mine / np.median(each) for mine, each in zip(own, other.rounds_us, strict=True)])
            )
            for other in others
            if other is not self and not other.missing
        }
        return {"name": self.name, "p50_us": p50, "p99_us": p99, "ratios": ratios}


def bench_peers(epochs: int, rounds: int, progress: Callable[[str], None]) -> list[dict[str, Json]]:
    """Time the chain in hierax and in each rival, in turn: idle and beside busy loops, small and large messages.

    Of each work and load all peers are told, those that are not installed too, with the reason. `progress` is told
    what is going on. Raises `HieraxError` if hierax or plain Zenoh fails; a rival that fails is told as missing."""
    tables = []
    for load in (0, LOAD):
        for work, picture in WORK.items():
            peers = _peers(work)
            for number in range(rounds):
                for peer in peers:
                    progress(f"{work}, {load} busy loops, round {number + 1} of {rounds}: {peer.name}")
                    _measure(peer, epochs, picture, load)
            tables.append({"work": work, "busy_loops": load, "peers": [peer.plain(peers) for peer in peers]})
    return tables


def _peers(work: str) -> list[Peer]:
    peers = [Peer(f"hierax, {links} links", partial(_ours, links=links)) for links in HIERAX[work]]
    peers += [Peer(f"plain Zenoh, {links} links", partial(bare, links=links)) for links in ZENOH[work]]
    for name, (module, place) in RIVALS.items():
        python = Path(sys.prefix, place, "bin", "python")
        missing = "" if python.exists() else f"{python} is not there; make peers installs it"
        peers.append(Peer(name, partial(_rival, python, module), missing))
    return peers


def _ours(epochs: int, picture: int, links: str) -> Sequence[float]:
    return [1e6 * each for each in ours(epochs, picture, links)]


def _measure(peer: Peer, epochs: int, picture: int, load: int) -> None:
    if peer.missing:
        return
    with busy(load):
        try:
            peer.rounds_us.append(counted(peer.run(epochs, picture)))
        except RivalError as error:
            peer.missing = str(error)


class RivalError(HieraxError):
    """A rival could not do the work."""


def _rival(python: Path, module: str, epochs: int, picture: int) -> Sequence[float]:
    """Run the program of a rival; what it prints. All that it starts ends with it."""
    program = ["-m", f"hierax.runtime.bench.rivals.{module}_chain", "--epochs", str(epochs), "--picture", str(picture)]
    with tempfile.TemporaryDirectory(prefix="hierax-bench-") as folder, ExitStack() as stack:
        errors = stack.enter_context(open(Path(folder) / "errors", "w+b"))
        process = subprocess.Popen(
            [python, *program], cwd=folder, stdout=subprocess.PIPE, stderr=errors, start_new_session=True
        )
        stack.callback(_kill_group, process)
        try:
            told, _ = process.communicate(timeout=TIMEOUT_S)
            times: list[float] = json.loads(told.splitlines()[-1])
        except (subprocess.TimeoutExpired, ValueError, IndexError):
            errors.seek(0)
            last = errors.read().decode(errors="replace").strip().splitlines()[-1:]
            raise RivalError(f"it failed: {''.join(last) or 'it told no times'}") from None
    return times


def _kill_group(process: "subprocess.Popen[bytes]") -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    finally:
        process.wait()


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """So many processes that do nothing but compute, at most until this one is gone."""
    code = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10000))"
    with ExitStack() as stack:
        for _ in range(loops):
            process = stack.enter_context(subprocess.Popen(python_code(code), start_new_session=True))
            stack.callback(process.kill)
        yield
