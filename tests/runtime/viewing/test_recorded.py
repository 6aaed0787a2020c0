from __future__ import annotations

from pathlib import Path

import pytest
from support.canvas import KeptCanvas

from hierax.runtime.commands.main import main
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading.loader import load_function
from hierax.runtime.recording.deployments import allowance_of, recorded_deployment
from hierax.runtime.recording.reading import Recording
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.viewing.recorded import show_recording
from hierax.runtime.viewing.single_run import run_seen

pytest.importorskip("mcap", reason="the extra [record] is not installed")


def recorded(folder: Path, name: str, epochs: int, *settings: str) -> Recording:
    path = folder / "run.mcap"
    options = [option for setting in settings for option in ("--set", setting)]
    assert main(["run", name, "--epochs", str(epochs), "--seed", "5", "--record", str(path), *options]) == 0
    return Recording.open(path)


@pytest.mark.parametrize(
    ("name", "settings", "epochs"),
    [("tracking", (), 3), ("letters-image", (), 2), ("servo", ("staleness=2",), 12)],
)
def test_a_recording_shows_what_the_run_showed(
    tmp_path: Path, name: str, settings: tuple[str, ...], epochs: int
) -> None:
    recording = recorded(tmp_path, name, epochs, *settings)
    deployment = recorded_deployment(recording.info)
    spec = read_deployment(name, settings).view
    assert deployment.view == spec
    together = None if spec.show is None else load_function(spec.show, "view.show", deployment.allowance)
    was, now = KeptCanvas(), KeptCanvas()
    run_seen(deployment, ViewPresenter(was, spec.layout, together), epochs=epochs, seed=5)
    assert show_recording(recording, ViewPresenter(now, spec.layout, together), allowance_of(recording)) == epochs
    was_plain, now_plain = was.plain("metrics/"), now.plain("metrics/")
    for things in (*was_plain.values(), *now_plain.values()):
        things.pop("epochs/took_ms", None)
    assert now_plain == was_plain
    assert now.cleared == was.cleared


def test_a_part_of_a_recording(tmp_path: Path) -> None:
    recording = recorded(tmp_path, "servo", 20)
    canvas, told = KeptCanvas(), list[int]()
    assert show_recording(recording, ViewPresenter(canvas), allowance_of(recording), 5, 9, told.append) == 5
    assert told == [5, 6, 7, 8, 9]
    assert sorted(canvas.drawn) == told
    assert "epochs/took_ms" not in canvas.drawn[5]
    assert canvas.drawn[6]["epochs/took_ms"].thing > 0.0  # type: ignore[operator]
