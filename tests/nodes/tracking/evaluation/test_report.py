"""Errors of a run from its two files."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import ResultsFile
from hierax.nodes.tracking.evaluation.report import ErrorPlot, main, read_errors, table
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """Object 2 is off by 3 mm and 2 degrees, and lost in frame 5."""
    true = make_pose(np.eye(3), np.array([0.1, 0.2, 0.5]))
    off = make_pose(exp_so3(np.array([0.0, 0.0, np.radians(2.0)])), np.array([0.1, 0.203, 0.5]))
    with ResultsFile(tmp_path / "truth.csv", 0) as truth, ResultsFile(tmp_path / "poses.csv", 0) as poses:
        for frame in range(8):
            status = "lost" if frame == 5 else "tracked"
            truth.write(frame, [{"obj_id": i, "pose": true, "score": 1.0, "status": "true"} for i in (1, 2)])
            poses.write(
                frame,
                [
                    {"obj_id": 1, "pose": true, "score": 1.0, "status": "tracked"},
                    {"obj_id": 2, "pose": off, "score": 1.0, "status": status},
                ],
            )
    return tmp_path


def test_errors_are_in_millimetres_and_degrees(output: Path) -> None:
    first, second = read_errors(output)
    assert (first.obj_id, second.obj_id) == (1, 2)
    np.testing.assert_allclose(first.distance_mm, 0.0, atol=1e-9)
    assert (first.missing, second.missing) == (0, 1)
    assert np.isnan(second.distance_mm[5])
    np.testing.assert_allclose(np.delete(second.distance_mm, 5), 3.0)
    np.testing.assert_allclose(np.delete(second.angle_deg, 5), 2.0)


def test_it_prints_a_line_an_object_and_draws_a_plot(output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(output)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[2].split()[:4] == ["2", "8", "1", "3.00"]
    plot = cv2.imread(str(output / "errors.png"))
    assert plot.shape == (520, 900, 3)
    assert (plot != 255).any()


def test_an_object_that_is_never_found_has_no_figures(output: Path) -> None:
    with ResultsFile(output / "poses.csv", 0):
        pass
    errors = read_errors(output)
    assert [item.missing for item in errors] == [8, 8]
    assert "–" in table(errors)
    assert main([str(output)]) == 0


def test_a_folder_without_truth_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 1
    assert "truth.csv: no such file" in capsys.readouterr().err
    with pytest.raises(DataError, match="truth"):
        read_errors(tmp_path)


def test_the_probe_draws_where_the_truth_is_known(output: Path, tmp_path: Path) -> None:
    probe = ErrorPlot()
    probe.open(output)
    probe.close()
    picture = cv2.imread(str(output / "errors.png"))
    assert picture is not None
    (output / "errors.png").unlink()
    (output / "truth.csv").unlink()
    probe.open_again(output)
    probe.close()
    assert not (output / "errors.png").exists()
    pose = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [100.0, 200.0, 500.0], "obj_id": 1}
    folder = tmp_path / "apart"
    folder.mkdir()
    (folder / "scene_gt.json").write_text(json.dumps({"0": [pose], "1": [pose]}))
    probe = ErrorPlot(str(folder))
    probe.open(output)
    probe.close()
    assert (output / "errors.png").exists()
    assert main([str(output), "--truth", str(folder)]) == 0
    with pytest.raises(DataError, match=r"scene_gt\.json: no such file"):
        ErrorPlot(str(tmp_path / "none")).open(output)
    nowhere = ErrorPlot(str(folder))
    nowhere.open(None)
    nowhere.close()


def test_a_truth_that_is_being_written_counts_as_far_as_it_is_whole(output: Path) -> None:
    text = (output / "truth.csv").read_text()
    (output / "truth.csv").write_text(text[:-40])
    first, second = read_errors(output)
    assert (len(first.frames), len(second.frames)) == (8, 7)
