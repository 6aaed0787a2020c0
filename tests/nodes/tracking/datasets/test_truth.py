"""True poses of all frames from a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.truth import read_truth

ENTRY = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [1.0, 2.0, 500.0], "obj_id": 7}


def write(folder: Path, frames: Any, infos: Any = None) -> Path:
    (folder / "scene_gt.json").write_text(json.dumps(frames))
    if infos is not None:
        (folder / "scene_gt_info.json").write_text(json.dumps(infos))
    return folder


def test_frames_are_in_order_with_visible_shares(tmp_path: Path) -> None:
    shares = {"10": [{"visib_fract": 0.25}]}
    truth = read_truth(write(tmp_path, {"10": [ENTRY], "9": [ENTRY]}, shares))
    assert list(truth) == [9, 10]
    assert truth[9][0].visible == 1.0
    assert truth[10][0].visible == 0.25
    assert truth[10][0].obj_id == 7
    assert truth[10][0].pose[:3, 3].tolist() == [0.001, 0.002, 0.5]


@pytest.mark.parametrize(
    ("frames", "infos", "said"),
    [
        ({}, None, "no frames"),
        ({"x": []}, None, "'x' is no frame number"),
        ({"0": ENTRY}, None, "frame 0: expected a list"),
        ({"0": [ENTRY, ENTRY]}, None, "object 1: obj_id 7 stands twice"),
        ({"0": [{**ENTRY, "obj_id": "a"}]}, None, "obj_id: expected the number"),
        ({"0": [{**ENTRY, "cam_t_m2c": [1.0]}]}, None, "cam_t_m2c: expected 3 numbers"),
        ({"0": [ENTRY]}, {"0": []}, "expected 1 entries"),
        ({"0": [ENTRY]}, {"0": [{}]}, "visib_fract: expected 1 numbers"),
        ({"0": [ENTRY]}, {"0": [7]}, "expected an object with visib_fract"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, frames: Any, infos: Any, said: str) -> None:
    with pytest.raises(DataError, match=said):
        read_truth(write(tmp_path, frames, infos))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"scene_gt\.json: no such file"):
        read_truth(tmp_path)
