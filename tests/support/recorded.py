"""Recordings for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from secrets import token_hex

from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_schedule
from hierax.runtime.execution import single
from hierax.runtime.execution.report import Report
from hierax.runtime.recording.info import RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.recorder import InProcess, Recorder


def record(
    path: Path,
    deployment: Deployment,
    epochs: int | None = None,
    *,
    seed: int = 0,
    settings: Sequence[str] = (),
    at: Sequence[str] = (),
) -> tuple[Recording, Report]:
    """A run of a deployment, recorded and checked."""
    info = RunInfo.of(deployment, token_hex(4), "run", seed, settings, from_start=True)
    recording = InProcess(Recorder(info, path, check=True))
    schedule = read_schedule(at, deployment)
    report = single.run(deployment, epochs=epochs, seed=seed, schedule=schedule, record=recording)
    recording.finish()
    assert recording.ending is not None
    assert not recording.ending.lost, recording.ending.gaps
    assert recording.checker is not None
    assert not recording.checker.close(), recording.checker.violations
    return Recording.open(path), report


def record_file(path: Path, file: str | Path, *settings: str, **options: object) -> tuple[Recording, Report]:
    """A run of a deployment file, recorded and checked."""
    return record(path, read_deployment(file, settings), settings=settings, **options)  # type: ignore[arg-type]
