"""Pictures through shared memory: the digests of one process, whoever keeps them, asks for memory or is killed."""

import json
import signal
from pathlib import Path
from typing import Any

import pytest
from support.launched import Launched, hierax, run_here, said_here, until
from support.picture_nodes import DEPLOYMENT, KEPT, lent_by

from hierax.runtime.recording.check import check_recording
from hierax.runtime.recording.reading import Recording

EPOCHS = 150


def deployment_in(folder: Path, size: int = 300_000) -> str:
    path = folder / "pictures.yaml"
    path.write_text(DEPLOYMENT.format(size=size))
    return str(path)


@pytest.mark.parametrize("kept", [0, 1000])
def test_digests_are_those_of_one_process(kept: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEPT, str(kept))
    deployment, options = deployment_in(tmp_path), ("--epochs", str(EPOCHS), "--seed", "3")
    alone = run_here(deployment, *options)
    launched = hierax("launch", deployment, *options)
    assert launched["digest"] == alone["digest"]
    assert launched["nodes"] == alone["nodes"]


def test_processes_are_killed_and_digests_stay_and_memory_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(KEPT, "4")
    deployment, options = deployment_in(tmp_path), ("--epochs", "400", "--seed", "3")
    alone: dict[str, Any] = run_here(deployment, *options)
    with Launched(tmp_path, deployment, *options) as launch:
        for number, node in enumerate(("low", "high", "world", "low"), start=1):
            launch.until_epoch(40 * number)
            until(lambda node=node: bool(lent_by(launch.until_pid(node))), "memory is shared")  # type: ignore[misc]
            assert sum(lent_by(launch.pid(node)).values()) < 60 * 300_000
            launch.kill(node)
        found = launch.report()
    assert found["digest"] == alone["digest"]
    assert not [name for name in Path("/dev/shm").iterdir() if "hierax" in name.name]


def test_what_a_node_says_last_before_another_takes_its_place_arrives(tmp_path: Path) -> None:
    deployment, snippet, schedule = deployment_in(tmp_path), tmp_path / "high.yaml", []
    snippet.write_text('nodes:\n  high: {class: "support.picture_nodes:Viewer"}\n')
    with Launched(tmp_path, deployment, "--epochs", "100000", "--seed", "3") as launch:
        for _ in range(3):
            launch.until_epoch(launch.epoch + 20)
            done = said_here("replace", "high", str(snippet), "--format", "json", folder=tmp_path)
            assert done.returncode == 0, (done.stderr, launch.err)
            schedule += ["--at", f"{json.loads(done.stdout)['epoch']}:replace:high:{snippet}"]
        launch.until_epoch(launch.epoch + 20)
        launch.process.send_signal(signal.SIGINT)
        report = json.loads(launch.end())
    alone = run_here(deployment, "--epochs", str(report["epochs"]), "--seed", "3", *schedule)
    assert report["digest"] == alone["digest"]
    assert "has told of none" not in launch.err, launch.err


def test_a_recording_that_begins_in_the_middle_has_all_pictures(tmp_path: Path) -> None:
    """Who records cannot read what is lent: it goes through the network as long as somebody records."""
    pytest.importorskip("mcap")
    deployment, size = deployment_in(tmp_path, 50_000), 50_000
    with Launched(tmp_path, deployment, "--epochs", "100000", "--seed", "3") as launch:
        for number in range(3):
            launch.until_epoch(launch.epoch + 30)
            until(lambda: bool(lent_by(launch.until_pid("high"))), "memory is shared")
            file = tmp_path / f"{number}.mcap"
            done = said_here("record", "-o", str(file), "--epochs", "20", folder=tmp_path)
            assert done.returncode == 0, done.stderr
            recording = Recording.open(file)
            assert not recording.loss
            assert recording.ending is not None
            assert not recording.ending.gaps
            assert check_recording(recording).violations == []
            pictures = [message.payload[0]["picture"] for _, message in recording.messages(node="high", kind="obs")]
            assert len(pictures) >= 20
            assert {picture.size for picture in pictures} == {size}
