"""What a run leaves behind: poses and truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.arm_steps import arm_belief, placed, step

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import RESULTS_HEADER, read_results, scene_number
from hierax.nodes.tracking.evaluation.pictures import Pictures
from hierax.nodes.tracking.evaluation.probes import BopResults, Truth
from hierax.nodes.tracking.math.geometry import invert
from hierax.nodes.tracking.simworld.world import SimWorld
from hierax.runtime.commands.main import main


def grey() -> Any:
    return np.full((120, 160), 90, np.uint8)


def test_results_are_on_disk_after_every_epoch(tmp_path: Path) -> None:
    probe = BopResults(str(tmp_path / "poses" / "mine.csv"), scene="data/test/000012/")
    probe.open(tmp_path)
    for frame in (3, 4):
        probe.record(step(frame, arm_belief(frame, x=0.01 * frame)))
        for path in (tmp_path / "poses" / "mine.csv", tmp_path / "poses.csv"):
            assert path.read_text().splitlines()[0] == RESULTS_HEADER
            rows = read_results(path)
            assert rows[-1].im_id == frame
            assert (rows[-1].scene_id, rows[-1].obj_id, rows[-1].score) == (12, 7, 0.75)
            np.testing.assert_allclose(rows[-1].pose, placed(0.01 * frame), atol=1e-12)
    probe.close()


def frames_of(path: Path) -> list[tuple[int, float]]:
    """Of each line of a results file the frame and the pose's x."""
    return [(row.im_id, round(float(row.pose[0, 3]), 6)) for row in read_results(path)]


def test_an_epoch_told_again_replaces_its_poses(tmp_path: Path) -> None:
    probe = BopResults(str(tmp_path / "mine.csv"))
    probe.open(tmp_path)
    probe.record(step(1, arm_belief(3, x=0.01)))
    probe.record(step(2, arm_belief(4, x=0.02)))
    probe.record(step(2, arm_belief(4, x=0.03), attempt=1))
    for path in (tmp_path / "mine.csv", tmp_path / "poses.csv"):
        assert frames_of(path) == [(3, 0.01), (4, 0.03)]
    probe.record(step(2, arm_belief(4, status="lost"), attempt=2))
    probe.close()
    assert frames_of(tmp_path / "poses.csv") == [(3, 0.01)]


def test_poses_of_a_new_process_come_behind_those_of_the_old_one(tmp_path: Path) -> None:
    files = (tmp_path / "mine.csv", tmp_path / "poses.csv")
    dead = BopResults(str(files[0]), scene="data/test/000012")
    dead.open(tmp_path)
    for frame in (3, 4, 5):
        dead.record(step(frame, arm_belief(frame, x=0.01 * frame)))
    dead.close()
    for path in files:
        with path.open("a") as file:
            file.write("12,6,7,0.7")  # killed within a line
    probe = BopResults(str(files[0]), scene="data/test/000012")
    probe.open_again(tmp_path)
    for path in files:
        assert frames_of(path) == [(3, 0.03), (4, 0.04), (5, 0.05)]
    probe.record(step(5, arm_belief(5, x=0.5), attempt=1))
    probe.record(step(6, arm_belief(6, x=0.6)))
    probe.close()
    for path in files:
        assert frames_of(path) == [(3, 0.03), (4, 0.04), (5, 0.5), (6, 0.6)]


@pytest.mark.parametrize("again", [False, True])
def test_one_file_named_twice_is_written_once(tmp_path: Path, again: bool) -> None:
    (tmp_path / "link").symlink_to(tmp_path, target_is_directory=True)
    probe = BopResults(str(tmp_path / "link" / "poses.csv"))
    probe.open(tmp_path)
    probe.record(step(1, arm_belief(3, x=0.1)))
    if again:
        probe.close()
        probe.open_again(tmp_path)
    probe.record(step(1, arm_belief(3, x=0.2), attempt=1))
    probe.record(step(2, arm_belief(4, x=0.3)))
    probe.close()
    assert frames_of(tmp_path / "poses.csv") == [(3, 0.2), (4, 0.3)]


@pytest.mark.parametrize("name", ["mine.csv", "poses.csv"])
def test_poses_that_are_there_are_not_written_over(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(f"{RESULTS_HEADER}\n")
    probe = BopResults(str(tmp_path / "mine.csv"))
    probe.open(tmp_path)  # as of a process that was killed before the run had begun
    probe.record(step(1, arm_belief(3, x=0.1)))
    probe.close()
    before = path.read_text()
    with pytest.raises(DataError, match=rf"{name}: is there already; --overwrite replaces it, or name another file$"):
        BopResults(str(path)).open(None)
    assert path.read_text() == before
    again = BopResults(str(path))
    again.overwrite = True
    again.open(None)
    again.close()
    assert read_results(path) == []


def test_a_second_run_writes_over_them_when_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "poses.csv"
    command = ["run", "tracking", "--epochs", "2", "--set", f"output={path}"]
    assert main(command) == 0
    before = path.read_text()
    path.write_text(before + before.splitlines()[-1] + "\n")
    assert main(command) == 1
    assert f"{path}: is there already; --overwrite replaces it, or name another file" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0
    assert path.read_text() == before


def test_what_is_lost_or_not_yet_seen_is_not_written(tmp_path: Path) -> None:
    probe = BopResults()
    probe.open(tmp_path)
    probe.record(step(1, arm_belief(None)))
    probe.record(step(2, arm_belief(1, status="lost")))
    probe.close()
    assert read_results(tmp_path / "poses.csv") == []


def test_without_a_file_and_a_folder_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for probe in (BopResults(), Truth(), Pictures()):
        probe.open(None)
        probe.record(step(1, {**arm_belief(0), "bodies": ()}, grey()))
        probe.close()
        probe.open_again(None)
        probe.record(step(1, {**arm_belief(0), "bodies": ()}, grey()))
        probe.close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(DataError, match="taken"):
        BopResults(str(tmp_path / "taken")).open(None)


def test_the_truth_of_the_simulated_world_is_seen_by_its_camera(tmp_path: Path) -> None:
    belief = SimWorld(cubes=2).initial_belief()
    probe = Truth()
    probe.open(tmp_path)
    probe.record(step(1, belief))
    probe.close()
    rows = read_results(tmp_path / "truth.csv")
    assert [row.obj_id for row in rows] == [1, 2]
    for row, body in zip(rows, belief["bodies"], strict=True):
        np.testing.assert_allclose(row.pose, invert(belief["camera"]) @ body["pose"], atol=1e-12)


def true_belief(frame: int, x: float) -> dict[str, Any]:
    return {"frame": frame, "camera": np.eye(4), "bodies": ({"obj_id": 1, "pose": placed(x)},)}


def test_the_truth_of_an_epoch_told_again_is_replaced(tmp_path: Path) -> None:
    dead = Truth()
    dead.open(tmp_path)
    dead.record(step(1, true_belief(0, 0.1)))
    dead.record(step(2, true_belief(1, 0.2)))
    dead.record(step(2, true_belief(1, 0.3), attempt=1))
    assert frames_of(tmp_path / "truth.csv") == [(0, 0.1), (1, 0.3)]
    dead.close()
    with (tmp_path / "truth.csv").open("a") as file:
        file.write("0,2,1,1.0,1 0")
    probe = Truth()
    probe.open_again(tmp_path)
    assert frames_of(tmp_path / "truth.csv") == [(0, 0.1), (1, 0.3)]
    probe.record(step(2, true_belief(1, 0.4), attempt=2))
    probe.record(step(3, true_belief(2, 0.5)))
    probe.close()
    assert frames_of(tmp_path / "truth.csv") == [(0, 0.1), (1, 0.4), (2, 0.5)]


def test_the_truth_begins_in_a_new_process_where_the_old_one_wrote_none(tmp_path: Path) -> None:
    probe = Truth()
    probe.open_again(tmp_path)
    probe.record(step(1, true_belief(0, 0.1)))
    probe.close()
    assert frames_of(tmp_path / "truth.csv") == [(0, 0.1)]


def test_another_runs_truth_is_not_kept_when_asked(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text(f"{RESULTS_HEADER}\n1,2,3,4\n")
    with pytest.raises(DataError, match=r"truth\.csv: is there already; --overwrite replaces it"):
        Truth().open(tmp_path)
    assert (tmp_path / "truth.csv").exists()
    probe = Truth()
    probe.overwrite = True
    probe.open(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["poses.csv", "truth.csv", "mine.txt"])
def test_a_users_files_are_not_touched(tmp_path: Path, name: str, overwrite: bool) -> None:
    path = tmp_path / name
    path.write_text("my notes\n")
    probe = Truth() if name == "truth.csv" else BopResults(str(tmp_path / "mine.txt"))
    probe.overwrite = overwrite
    with pytest.raises(DataError, match=rf"{name}: is no results file, and is not replaced; name another file$"):
        probe.open(tmp_path)
    assert [each.read_text() for each in tmp_path.iterdir()] == ["my notes\n"]


@pytest.mark.parametrize("name", ["pictures/frame-000007.png", "pictures/contact-sheet.png", "video.mp4"])
def test_pictures_that_are_there_are_not_written_over(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("mine")
    (path.parent / "holiday.png").write_text("mine, too")
    with pytest.raises(DataError, match=rf"{name}: is there already; --overwrite replaces it, or name another output"):
        Pictures(video=True).open(tmp_path)
    assert path.read_text() == "mine"
    probe = Pictures(video=True)
    probe.overwrite = True
    probe.open(tmp_path)
    path.unlink()
    Pictures(video=True).open(tmp_path)


def test_a_world_of_photographs_knows_no_truth(tmp_path: Path) -> None:
    probe = Truth()
    probe.open(tmp_path)
    probe.record(step(1, {"scene": "data/test/000001", "index": 0}))
    probe.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("folder", "number"), [(None, 0), ("a/b/000021", 21), ("a/b/cubes", 0), ("000003/", 3)])
def test_a_scene_is_numbered_by_its_folder(folder: str | None, number: int) -> None:
    assert scene_number(folder) == number
