"""What the arm believed of each object in each frame, beside the truth: for judging what it says of its certainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hierax.nodes.tracking.datasets.truth import TruePose
from hierax.nodes.tracking.errors import writing
from hierax.nodes.tracking.evaluation.scoring import nearest_off
from hierax.nodes.tracking.math.geometry import Array, log_se3, pose_error
from hierax.runtime import Probe, Step

_KEPT = ("status", "score", "probability", "pose", "covariance")


class Beliefs(Probe):
    """The arm's corrected belief of each object in each frame, as a NumPy archive that is written at the end.

    One entry for each object in each frame: ``frame``, ``obj_id``, ``status``, ``score``, ``probability``, ``pose``
    (camera_from_object, metres) and ``covariance`` (6 × 6, of a twist in the object's frame, m² and rad²). Objects
    that are lost are there, too. A frame that is told again replaces what was told of it.

    Args: file: path, relative to the folder that the run was started in.
    """

    def __init__(self, file: str) -> None:
        self._file = Path(file)
        self._entries: dict[tuple[int, int], dict[str, Array | str | float]] = {}

    def record(self, step: Step) -> None:
        """One frame's beliefs."""
        belief = step.sensed
        if belief["frame"] is None:
            return
        for item in belief["objects"]:
            kept = {name: item[name] for name in _KEPT if name in item}
            self._entries[belief["frame"], item["obj_id"]] = kept

    def close(self) -> None:
        """Write the file."""
        keys = sorted(self._entries)
        columns = {name: [self._entries[key][name] for key in keys] for name in next(iter(self._entries.values()), {})}
        places = np.array(keys, dtype=np.int64).reshape(-1, 2)
        _write(self._file, {"frame": places[:, 0], "obj_id": places[:, 1], **columns})


def judge(file: Path, truth: Mapping[int, Sequence[TruePose]]) -> None:
    """Add the truth to a file of `Beliefs`, to those of its entries that are of an object that the truth knows.

    Adds ``visible`` (share, 0 to 1), ``distance_mm``, ``angle_deg`` and ``twist``, the ξ with which
    ``pose @ exp_se3(ξ)`` is the truth, in metres and radians: what ``covariance`` is of.

    Raises DataError: the file cannot be written.
    """
    true = {(frame, pose.obj_id): pose for frame, poses in truth.items() for pose in poses}
    with np.load(file) as archive:
        columns = dict(archive)
    keys = list(zip(columns["frame"].tolist(), columns["obj_id"].tolist(), strict=True))
    known = np.array([key in true for key in keys], dtype=bool)
    columns = {name: column[known] for name, column in columns.items()}
    pairs = [(pose, true[key]) for pose, key in zip(columns["pose"], (key for key in keys if key in true), strict=True)]
    off = [nearest_off(right, given) for given, right in pairs]
    errors = np.array([pose_error(each, np.eye(4)) for each in off]).reshape(-1, 2)
    added = {
        "visible": np.array([right.visible for _, right in pairs]),
        "distance_mm": 1000.0 * errors[:, 0],
        "angle_deg": np.degrees(errors[:, 1]),
        "twist": np.array([-log_se3(each) for each in off]).reshape(-1, 6),
    }
    _write(file, {**columns, **added})


def _write(path: Path, columns: Mapping[str, object]) -> None:
    arrays: dict[str, Any] = {name: np.asarray(column) for name, column in columns.items()}
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)
