from __future__ import annotations

from pathlib import Path

import pytest
from support.canvas import KeptCanvas

from hierax.runtime.commands.main import main
from hierax.runtime.core.node import Node
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading.loader import load_function
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import allowance_of, recorded_deployment
from hierax.runtime.viewing.live import run_seen
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.viewing.recorded_run import recorded_look, show_recording
from hierax.runtime.viewing.views import ShownNodes
from hierax.schemas.roster import Roster

pytest.importorskip("mcap", reason="the extra [record] is not installed")


RATED = ("nodes.motion.every=5", "nodes.motion.offset=2", "edges.camera -> motion.delay=3")


def recorded(folder: Path, name: str, epochs: int, *settings: str) -> Recording:
    path = folder / "run.mcap"
    options = [option for setting in settings for option in ("--set", setting)]
    assert main(["run", name, "--epochs", str(epochs), "--seed", "5", "--record", str(path), *options]) == 0
    return Recording.open(path)


@pytest.mark.parametrize(
    ("name", "settings", "epochs"),
    [("tracking", (), 3), ("letters-image", (), 2), ("servo", ("staleness=2",), 12), ("servo", RATED, 12)],
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
    canvas = KeptCanvas()
    assert show_recording(recording, ViewPresenter(canvas), allowance_of(recording), 5, 9) == 5
    assert sorted(canvas.drawn) == [5, 6, 7, 8, 9]
    assert "epochs/took_ms" not in canvas.drawn[5]
    assert canvas.drawn[6]["epochs/took_ms"].thing > 0.0  # type: ignore[operator]


def test_of_a_node_that_is_looked_at_no_other_is_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded(tmp_path, "servo", 5)
    built: list[str] = []
    node = ShownNodes.node

    def told(nodes: ShownNodes, roster: Roster, name: str) -> Node:
        built.append(name)
        return node(nodes, roster, name)

    monkeypatch.setattr(ShownNodes, "node", told)
    look, _ = recorded_look(recording, "motion", None, allowance_of(recording))
    assert look.step.epoch == 5
    assert set(built) == {"motion"}


def test_a_node_that_was_there_for_a_while(tmp_path: Path) -> None:
    node = "nodes: {other: {class: hierax.nodes.servo:MotionNode}}\n"
    (tmp_path / "other.yaml").write_text(f"{node}edges: {{camera -> other: {{sense: hierax.nodes.servo:position}}}}\n")
    path = tmp_path / "run.mcap"
    changes = ["--at", f"4:attach:{tmp_path / 'other.yaml'}", "--at", "8:detach:other"]
    assert main(["run", "servo", "--epochs", "12", *changes, "--record", str(path)]) == 0
    recording = Recording.open(path)
    look, _ = recorded_look(recording, "other", 5, allowance_of(recording))
    assert look.step.epoch == 5
    for epoch in (2, None):
        with pytest.raises(RecordingError, match="no node 'other' in that epoch; it took part from epoch 4 to 7: give"):
            recorded_look(recording, "other", epoch, allowance_of(recording))


def test_what_a_node_did_last_is_found_however_many_epochs_it_has_left_out_since(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rates = ("staleness=null", "nodes.world.rate_hz=1000", "nodes.arm.rate_hz=1000", "nodes.spatial.rate_hz=1")
    options = [option for setting in rates for option in ("--set", setting)]
    # the last epoch of the run, which all nodes do, is not in it
    bounds = ["--epochs", "200", "--record", str(path), "--max-size", "120kB"]
    assert main(["run", "chain", *bounds, *options]) == 0
    recording = Recording.open(path)
    assert recording.ending is not None
    last = recording.ending.last
    done = max(step.epoch for step in recording.steps("spatial"))
    assert done < last - 1
    look, _ = recorded_look(recording, "spatial", None, allowance_of(recording))
    assert look.step.epoch == done
    with pytest.raises(RecordingError, match=f"did in epoch {last} is not in it; it took part in epoch {done} last"):
        recorded_look(recording, "spatial", last, allowance_of(recording))


def test_of_a_recording_that_was_cut_is_shown_what_there_is(tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    options = ["--epochs", "600", "--record", str(path)]
    assert main(["run", "servo", *options, "--max-size", "100kB"]) == 0
    cut = Recording.open(path)
    assert cut.ending is not None
    for size, least in ((None, cut.ending.last), (-40, 10), (path.stat().st_size // 2, 1)):
        if size is not None:
            path.write_bytes(path.read_bytes()[:size])
        recording = Recording.open(path)
        canvas = KeptCanvas()
        shown = show_recording(recording, ViewPresenter(canvas), allowance_of(recording, True))
        assert sorted(canvas.drawn) == list(range(1, shown + 1))
        assert least <= shown <= cut.ending.last
        assert recording.loss


@pytest.mark.parametrize("pattern", ["obs/world/*", "steps/camera"])
def test_what_was_left_out_is_not_shown_and_the_rest_is(tmp_path: Path, pattern: str) -> None:
    path = tmp_path / "part.mcap"
    assert main(["run", "servo", "--epochs", "5", "--record", str(path), "--exclude", pattern]) == 0
    whole, part = KeptCanvas(), KeptCanvas()
    for canvas, recording in ((whole, recorded(tmp_path, "servo", 5)), (part, Recording.open(path))):
        assert show_recording(recording, ViewPresenter(canvas), allowance_of(recording)) == 5
    lacks = whole.drawn[5].keys() - part.drawn[5].keys()
    assert lacks
    assert all("camera" in path.split("/") for path in lacks), lacks


def test_a_recording_without_steps_has_nothing_to_show_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun", reason="the extra [view] is not installed")
    path = tmp_path / "part.mcap"
    assert main(["run", "servo", "--epochs", "5", "--record", str(path), "--exclude", "steps/**"]) == 0
    capsys.readouterr()
    assert main(["view", str(path), "--save", str(tmp_path / "part.rrd")]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"error: {path}: no step of the world is recorded, so it is not known which epochs were committed: "
        "steps/world was left out (--exclude steps/**)"
    )
