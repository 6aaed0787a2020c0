"""JSON files of the BOP format: each part is checked, and what is wrong is said with its place."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from hierax.nodes.sources.files import DataError, read_file, read_numbers
from hierax.nodes.sources.shots import MAX_DISTANCE_M, is_rotation
from hierax.nodes.tracking.math.geometry import Floats, make_pose, orthonormal
from hierax.nodes.tracking.model.files import BOP_UNIT_M
from hierax.nodes.tracking.model.symmetry import symmetry_of
from hierax.nodes.tracking.schema import Symmetry

MAX_NUMBER = 999_999  # of a frame, and of a model: files' names have six digits
MAX_SYMMETRIES = 128
_SYMMETRIES = {"symmetries_discrete", "symmetries_continuous"}


def read_json(path: Path) -> dict[str, Any]:
    """A file that holds one object, with an entry for each number. Raises DataError: it is missing or damaged."""
    try:
        content = json.loads(read_file(path, "JSON").decode("utf-8"))
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not a text file; expected JSON") from error
    except json.JSONDecodeError as error:
        raise DataError(f"{path}, line {error.lineno}, column {error.colno}: {error.msg}; expected JSON") from error
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, or lists within lists
        raise DataError(f"{path}: {error!s:.100}; expected JSON with an entry for each number") from error
    if not isinstance(content, dict):
        raise DataError(f"{path}: expected a JSON object with an entry for each number")
    return content


def read_obj_id(where: str, entry: Any) -> int:
    """The number of an entry's model. Raises DataError: there is none."""
    obj_id = entry.get("obj_id") if isinstance(entry, dict) else None
    if type(obj_id) is not int or not 0 <= obj_id <= MAX_NUMBER:
        raise DataError(f"{where}: obj_id: expected the number of a model")
    return obj_id


def read_pose(where: str, entry: Any, rotation_key: str, translation_key: str) -> Floats:
    """A pose in metres of an entry's rotation, row by row, and translation in millimetres. Raises DataError: one is
    missing, or no rotation."""
    rotation = read_numbers(where, entry, rotation_key, 9).reshape(3, 3)
    translation = read_numbers(where, entry, translation_key, 3) * BOP_UNIT_M
    if np.abs(translation).max() > MAX_DISTANCE_M:
        raise DataError(f"{where}: {translation_key}: expected millimetres, at most {MAX_DISTANCE_M:g} m")
    if not is_rotation(rotation):
        raise DataError(f"{where}: {rotation_key}: expected a rotation matrix, row by row")
    return orthonormal(make_pose(rotation, translation))


def pose_entry(pose: Floats, rotation_key: str = "cam_R_m2c", translation_key: str = "cam_t_m2c") -> dict[str, Any]:
    """A pose as `read_pose` reads it."""
    return {rotation_key: pose[:3, :3].ravel().tolist(), translation_key: (pose[:3, 3] / BOP_UNIT_M).tolist()}


def read_symmetry(where: str, entry: Any, posed: bool = True) -> Symmetry | None:
    """What an entry of ``models_info.json`` says of symmetry; None where it says nothing, and none where its lists of
    ``symmetries_discrete`` and ``symmetries_continuous`` are empty. Of an object whose first pose nobody tells (not
    `posed`) empty lists say nothing: of the poses that look alike there is none to be kept, and models have no paint.
    Raises DataError: they are no lists of at most `MAX_SYMMETRIES` rigid motions, row by row, or of axes."""
    if not _SYMMETRIES & entry.keys():
        return None
    lists = {key: entry.get(key, []) for key in sorted(_SYMMETRIES)}
    for key, values in lists.items():
        if not isinstance(values, list) or len(values) > MAX_SYMMETRIES:
            raise DataError(f"{where}: {key}: expected a list of at most {MAX_SYMMETRIES}")
    if not posed and not any(lists.values()):
        return None
    turns, axes = [], []
    for values in lists["symmetries_discrete"]:
        rows = read_numbers(where, {"symmetries_discrete": values}, "symmetries_discrete", 16).reshape(4, 4)
        parts = {"rotation": rows[:3, :3].ravel().tolist(), "translation": rows[:3, 3].tolist()}
        turns.append(read_pose(f"{where}: symmetries_discrete", parts, "rotation", "translation"))
    for each in lists["symmetries_continuous"]:
        axis = read_numbers(f"{where}: symmetries_continuous", each, "axis", 3)
        if not axis.any():
            raise DataError(f"{where}: symmetries_continuous: axis: expected a direction")
        axes.append((axis, read_numbers(f"{where}: symmetries_continuous", each, "offset", 3) * BOP_UNIT_M))
    return symmetry_of(turns, axes)
