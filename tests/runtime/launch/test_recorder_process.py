"""The recorder beside a launch listens before any process of a node is started; without it there is no recording."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread
import pytest
from support.live import TESTS

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.report import Report
from hierax.runtime.launch import recorder_process
from hierax.runtime.launch.recorder_process import RecordingRequest
from hierax.runtime.launch.supervisor import Supervisor, launch
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.writing import claimed
from hierax.runtime.transport.launch_client import LaunchClient

Launch = Callable[..., tuple[Report, RecordingRequest]]
EPOCHS = 3


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Launch:
    """A launch that is recorded and checked."""
    monkeypatch.setenv("PYTHONPATH", str(TESTS))

    def begin(*lines: str) -> tuple[Report, RecordingRequest]:
        path = tmp_path / "one.yaml"
        nodes = 'nodes:\n  clock: {class: "support.slow_nodes:Clock"}\n'
        path.write_text("\n".join(["hierarchy: one", "world: clock", *lines, nodes]), encoding="utf-8")
        with claimed(tmp_path / "one.mcap") as target:
            request = RecordingRequest(target, check=True)
            return launch(read_deployment(path), epochs=EPOCHS, seed=0, recording=request), request

    return begin


def start_instead(patch: pytest.MonkeyPatch, code: str) -> None:
    """Have a recorder be a Python process that does this."""
    patch.setattr(recorder_process, "python_module", lambda module: [sys.executable, "-c", code])


def test_no_process_is_started_before_the_recorder_listens(
    recorded: Launch, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """On a busy machine it may take longer to come up than nodes wait for it, and the first epochs would lack."""
    listened: list[bool] = []
    told: list[Any] = []
    start_all = Supervisor._start_all

    async def looks(supervisor: Supervisor) -> None:
        listened.append(supervisor._recorder is not None and supervisor._recorder.is_up)
        hub = supervisor._hub
        with LaunchClient(hub.endpoint, secret=hub.secret) as client:
            told.append(await anyio.to_thread.run_sync(client.ask, {"ask": "ps"}))
        await start_all(supervisor)

    monkeypatch.setattr(Supervisor, "_start_all", looks)
    _, request = recorded()
    assert listened == [True]
    assert [(each["epoch"], each["nodes"]) for each in told] == [(0, {})], "it can be asked meanwhile"
    assert request.ending is not None
    assert (request.ending.first, request.ending.last, request.ending.lost) == (1, EPOCHS, 0)
    assert Recording.open(tmp_path / "one.mcap").ending == request.ending


def test_a_recorder_that_does_not_come_up_is_named(recorded: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    start_instead(monkeypatch, "import threading; threading.Event().wait()")
    with pytest.raises(HieraxError, match=r"not up within 0.2 s \(start_timeout_s\): recorder"):
        recorded("start_timeout_s: 0.2")


def test_where_the_recorder_ends_at_once_the_run_goes_on_without(
    recorded: Launch, monkeypatch: pytest.MonkeyPatch
) -> None:
    start_instead(monkeypatch, "raise SystemExit(7)")
    report, request = recorded()
    assert report.epochs == EPOCHS
    assert request.failure == "the recorder's process ended with exit code 7"
