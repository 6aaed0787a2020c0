"""`hierax bench epoch`: an epoch of a chain of three processes, beside the same chain in bare Zenoh."""

import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hierax.runtime.bench.bare_chain import LOW_LATENCY, ORDINARY
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.report import Json, Report
from hierax.runtime.host.streams import python_module
from hierax.runtime.launch.recorder_process import RecordingRequest
from hierax.runtime.launch.supervisor import launch
from hierax.runtime.recording.writing import claimed
from hierax.runtime.transport.zenoh_session import free_endpoint

Times = NDArray[np.float64]  # how long epochs took, in microseconds

PICTURE_BYTES = 2_400_000
RECORDED = "recorded"  # ordinary ones, and a recorder that hears them
WARM_UP = 0.1  # share of the epochs, at the beginning of each run, that is not counted
TIMEOUT_S = 120.0


@dataclass(frozen=True)
class Row:
    """One kind of work, ours and bare: for each round, the counted epochs, in microseconds."""

    name: str
    ours_us: Sequence[Times]
    bare_us: Sequence[Times]

    def plain(self) -> dict[str, Json]:
        """Give it as plain JSON; the ratio is the median of those of the rounds' medians."""
        ratios = np.array([np.median(a) / np.median(b) for a, b in zip(self.ours_us, self.bare_us, strict=True)])
        ratio, span = float(np.median(ratios)), [float(ratios.min()), float(ratios.max())]
        ours_us, bare_us = _quantiles(self.ours_us), _quantiles(self.bare_us)
        return {"name": self.name, "ours_us": ours_us, "bare_us": bare_us, "ratio": ratio, "ratio_range": span}


def bench_epoch(epochs: int, rounds: int, progress: Callable[[str], None]) -> list[Row]:
    """Time the chain with small messages and with a picture, the former recorded against not recorded (where the
    package ``mcap`` is there), and the bare chain against a bare round trip. So many epochs are in each round; rounds
    of all take turns, so that a machine that changes its pace changes it for all. `progress` is told what is going on.
    Raises `HieraxError` if a process failed, or a recording is not whole."""
    rows = []
    small = (LOW_LATENCY, ORDINARY, *((RECORDED,) if find_spec("mcap") else ()))
    for name, picture, kinds in (
        ("small messages", 0, small),
        (f"{PICTURE_BYTES / 1e6:g} MB in the context", PICTURE_BYTES, (ORDINARY,)),
    ):
        bare_us: list[Times] = []
        ours_us: dict[str, list[Times]] = {links: [] for links in kinds}
        for number in range(rounds):
            progress(f"{name}, round {number + 1} of {rounds}")
            bare_us.append(counted(bare(epochs, picture)))
            for links, times in ours_us.items():
                times.append(counted(1e6 * np.array(ours(epochs, picture, links))))
        recorded = ours_us.pop(RECORDED, None)
        rows += [Row(f"{name}, {links} links", times, bare_us) for links, times in ours_us.items()]
        if recorded is not None:
            rows.append(Row(f"{name}, recorded against not recorded (ours)", recorded, ours_us[ORDINARY]))
    trips = []
    for number in range(rounds):
        progress(f"bare round trip, round {number + 1} of {rounds}")
        low = free_endpoint()
        world = ["world", "--listen", low, "--epochs", str(epochs)]
        trips.append(counted(_times(world, ["echo", "--connect", low])))
    rows.append(Row("bare chain (ours) against a bare round trip", rows[0].bare_us, trips))
    return rows


def ours(epochs: int, picture: int, links: str) -> Sequence[float]:
    """How long epochs of our chain took, in seconds."""
    given = [f"picture={picture}", f"low_latency={json.dumps(links == LOW_LATENCY)}"]
    deployment = read_deployment("chain", given)
    if links != RECORDED:
        return from_commit_to_commit(launch(deployment, epochs=epochs, seed=0))
    with tempfile.TemporaryDirectory(prefix="hierax-bench-") as folder, claimed(Path(folder) / "run.mcap") as target:
        recording = RecordingRequest(target, check=False)
        report = launch(deployment, epochs=epochs, seed=0, recording=recording)
    if recording.ending is None or recording.ending.lost:
        raise HieraxError(f"the recording is not whole: {recording.failure or recording.ending}")
    return from_commit_to_commit(report)


def from_commit_to_commit(report: Report) -> Sequence[float]:
    """How long epochs took, in seconds, with what lies between two of them, in equal parts: stopwatches of rivals run
    on. A report's own epochs end with their commit, and begin when the world begins them."""
    between_s = (report.wall_s - sum(report.epochs_s)) / max(1, len(report.epochs_s))
    return [each + between_s for each in report.epochs_s]


def bare(epochs: int, picture: int, links: str = ORDINARY) -> Sequence[float]:
    """How long epochs of the bare chain took, in microseconds."""
    low, high, kind = free_endpoint(), free_endpoint(), ["--links", links]
    return _times(
        ["world", "--listen", low, "--epochs", str(epochs), *kind],
        ["arm", "--connect", low, "--listen", high, *kind],
        ["spatial", "--connect", high, "--picture", str(picture), *kind],
    )


def _times(world: list[str], *others: list[str]) -> Sequence[float]:
    """Run the processes of a bare chain; what the world prints."""
    module = python_module("hierax.runtime.bench.bare_chain")
    reader, writer = os.pipe()  # they end when it does, however this process comes to its end
    with ExitStack() as stack, open(writer, "wb"), open(reader, "rb"):
        for other in others:  # each with a session of its own: Ctrl-C is for who has started it
            stack.enter_context(subprocess.Popen([*module, *other], stdin=reader, start_new_session=True))
        try:
            command = [*module, *world]
            done = subprocess.run(
                command, stdin=reader, stdout=subprocess.PIPE, timeout=TIMEOUT_S, check=True, start_new_session=True
            )
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
            raise HieraxError(f"the bare chain failed: {error}") from error
    times: list[float] = json.loads(done.stdout)
    return times


def counted(epochs_us: Sequence[float] | Times) -> Times:
    """Those after the warm-up."""
    return np.array(epochs_us[int(WARM_UP * len(epochs_us)) :])


def _quantiles(rounds_us: Sequence[Times]) -> dict[str, float]:
    p50, p99 = np.percentile(np.concatenate(list(rounds_us)), (50, 99))
    return {"p50": float(p50), "p99": float(p99)}
