"""First poses that a user gives, in a file of their own beside a scene's, of which none is written over."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from hierax.nodes.sources.files import DataError, write_whole
from hierax.nodes.tracking.datasets.bop import FIRST_POSES, MAX_OBJECTS, TOLD_POSES, BopScene
from hierax.nodes.tracking.datasets.bop_json import pose_entry, read_json
from hierax.nodes.tracking.math.geometry import Floats


def objects_of(scene: BopScene) -> list[int]:
    """Numbers of the models of a scene's objects: of those that ``scene_gt.json`` names for the first frame; where
    there is no such file, of all models. Raises DataError: a file is missing or damaged, or there are no models, or too
    many."""
    if (scene.folder / TOLD_POSES).exists():
        return [item.obj_id for item in scene.first_objects(poses=False)]
    info = scene.models / "models_info.json"
    numbers = read_json(info)
    if not 0 < len(numbers) <= MAX_OBJECTS or not all(key.isdecimal() and len(key) <= 6 for key in numbers):
        raise DataError(f"{info}: expected an entry for the number of each model, 1 to {MAX_OBJECTS} of them")
    return sorted(int(key) for key in numbers)


def check_writable(scene: BopScene, overwrite: bool) -> Path:
    """The file of a scene's first poses. Raises DataError: it is there already, or its folder may not be written in."""
    path = scene.folder / FIRST_POSES
    if path.exists() and not overwrite:
        raise DataError(f"{path}: is there already; --overwrite replaces it")
    if not os.access(scene.folder, os.W_OK):
        raise DataError(f"{path}: cannot be written; expected a folder that may be written in")
    return path


def write_first_poses(path: Path, scene: BopScene, poses: Sequence[tuple[int, Floats]]) -> None:
    """Write poses, model's number and camera_from_object, of the first frame. Raises DataError: that fails."""
    entries = [{**pose_entry(pose), "obj_id": obj_id} for obj_id, pose in poses]
    write_whole(path, (json.dumps({str(scene.frames[0].im_id): entries}, indent=1) + "\n").encode())
