"""The true poses of a scene's frames, for judging a run after it: no node reads them."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.sources.files import DataError, read_numbers
from hierax.nodes.tracking.datasets.bop import dataset_of, read_model
from hierax.nodes.tracking.datasets.bop_json import read_json, read_obj_id, read_pose
from hierax.nodes.tracking.imagery.physics import support_points
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.symmetry import NONE
from hierax.nodes.tracking.schema import Symmetry

POSES = "scene_gt.json"
SHARES = "scene_gt_info.json"


class Likeness(NamedTuple):
    """What of a model says how far two poses of it are apart."""

    symmetry: Symmetry
    points: Floats  # (n, 3) outermost points of it, metres


class TruePose(NamedTuple):
    """An object in a frame."""

    obj_id: int  # the object
    pose: Floats  # camera_from_object, metres
    visible: float  # share of its silhouette that is seen, 0 to 1; 1 where nobody says
    likeness: Likeness | None = None  # None where there are no models

    @property
    def symmetry(self) -> Symmetry:
        """That of its model; none where there is none."""
        return NONE if self.likeness is None else self.likeness.symmetry


def read_truth(folder: Path, posed: bool = True) -> dict[int, list[TruePose]]:
    """By frame, in order, all of a folder with ``scene_gt.json`` and, where visible shares are known,
    ``scene_gt_info.json``; models are looked for where a scene in the BOP format has them; `posed`: whether first
    poses are told, see `hierax.nodes.tracking.datasets.bop_json.read_symmetry`. Raises DataError: a file is
    missing or damaged, or an object stands twice in a frame."""
    path = folder / POSES
    entries = read_json(path)
    infos = read_json(folder / SHARES) if (folder / SHARES).is_file() else {}
    wrong = [key for key in entries if not key.isdecimal()]
    if wrong:
        raise DataError(f"{path}: {wrong[0]!r} is no frame number")
    if not entries:
        raise DataError(f"{path}: no frames")
    frames = {int(key): _frame(folder, key, entries[key], infos.get(key)) for key in sorted(entries, key=int)}
    models = dataset_of(folder) / "models"
    if not (models / "models_info.json").is_file():
        return frames
    numbers = {pose.obj_id for poses in frames.values() for pose in poses}
    known = {obj_id: _likeness(models, obj_id, posed) for obj_id in sorted(numbers)}
    return {at: [pose._replace(likeness=known[pose.obj_id]) for pose in poses] for at, poses in frames.items()}


def _likeness(models: Path, obj_id: int, posed: bool) -> Likeness:
    mesh, symmetry = read_model(models, obj_id, posed)
    return Likeness(symmetry, support_points(mesh.vertices[np.unique(mesh.faces)]))


def _frame(folder: Path, key: str, entries: Any, infos: Any) -> list[TruePose]:
    path = folder / POSES
    if not isinstance(entries, list):
        raise DataError(f"{path}: frame {key}: expected a list of objects")
    if infos is not None and (not isinstance(infos, list) or len(infos) != len(entries)):
        raise DataError(f"{folder / SHARES}: frame {key}: expected {len(entries)} entries, as in {POSES}")
    poses: list[TruePose] = []
    for at, entry in enumerate(entries):
        where = f"frame {key}, object {at}"
        obj_id = read_obj_id(f"{path}: {where}", entry)
        if any(earlier.obj_id == obj_id for earlier in poses):
            raise DataError(f"{path}: {where}: obj_id {obj_id} stands twice; results files could not tell them apart")
        pose = read_pose(f"{path}: {where}", entry, "cam_R_m2c", "cam_t_m2c")
        visible = 1.0 if infos is None else _share(f"{folder / SHARES}: {where}", infos[at])
        poses.append(TruePose(obj_id, pose, visible))
    return poses


def _share(where: str, info: Any) -> float:
    if not isinstance(info, dict):
        raise DataError(f"{where}: expected an object with visib_fract")
    (share,) = read_numbers(where, {"visib_fract": [info.get("visib_fract")]}, "visib_fract", 1)
    return float(share)
