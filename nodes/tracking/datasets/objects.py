"""Objects of a camera without a scene folder: models and first poses in a small YAML file beside them.

    camera: [[…], […], […], [0, 0, 0, 1]]    # world_from_camera; left out: the world is the camera's, or a tag tells
    objects:
      - {id: 1, model: cube.ply, unit: mm, pose: [[…], …], frame: camera}

Poses are metres, in the frame of the first picture's camera, or of the world; ``pose: null`` is looked for. The unit is
of the model's vertices, mm by default."""

import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.sources.files import UNITS_M, DataError, read_yaml
from hierax.nodes.sources.shots import read_matrix
from hierax.nodes.tracking.datasets.bop import MAX_OBJECTS, box_diagonal_m, check_large
from hierax.nodes.tracking.datasets.bop_json import read_symmetry
from hierax.nodes.tracking.math.geometry import Floats, invert, orthonormal, transform
from hierax.nodes.tracking.model.files import read_mesh
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.model.symmetry import found_symmetry
from hierax.nodes.tracking.schema import FirstPose, Symmetry

CAMERA, WORLD = "camera", "world"
_FIELDS = ("id", "model", "unit", "pose", "frame", "symmetries_discrete", "symmetries_continuous")
_EXPECTED = "a list of objects, and world_from_camera where it is known"
_LEAST_SEEN = 0.002  # what is smaller beside its distance is no two pixels
_INSIDE = 3.0  # what is larger beside it is about the camera

_LOG = logging.getLogger("hierax")


class ObjectsFile(NamedTuple):
    """What the file says."""

    path: Path
    objects: tuple[FirstPose, ...]  # each pose in the frame below
    frame: str  # of all poses: the camera's, or, where one is told in it, the world's
    mixed: bool  # whether some were told in the camera's and some in the world's
    camera: Floats | None  # world_from_camera; None: it is not told
    models: tuple[tuple[Path, float, dict[str, Any]], ...]  # of each object its file, unit in metres, and entry

    @property
    def world_from_frame(self) -> Floats:
        """Of the frame of the poses, as far as the file tells."""
        return np.eye(4) if self.frame == WORLD or self.camera is None else self.camera

    def read_models(self, tagged: bool = False) -> list[tuple[Mesh, Symmetry]]:
        """Each object's mesh and symmetry; `tagged`: the world's frame is that of a tag in the pictures.

        Raises DataError: a model is missing or damaged, or no camera sees an object that is so large, there."""
        found = []
        for at, (model, unit_m, entry) in enumerate(self.models):
            mesh, where = read_mesh(model, unit_m), f"{self.path}: objects[{at}]"
            self._check_seen(where, mesh, self.objects[at]["pose"], tagged)
            found.append(
                (mesh, read_symmetry(where, entry, self.objects[at]["pose"] is not None) or found_symmetry(mesh))
            )
        return found

    def _check_seen(self, where: str, mesh: Mesh, pose: Floats | None, tagged: bool) -> None:
        check_large(where, mesh)
        size_m = box_diagonal_m(mesh)
        if pose is None:
            return
        if self.frame == WORLD and self.camera is not None:
            pose = invert(self.camera) @ pose
        points = transform(pose, mesh.vertices)
        away_m = float(np.linalg.norm(points.mean(axis=0)))
        if size_m < _LEAST_SEEN * away_m:
            what = f"the object is {away_m:.3g} m away and {size_m:.3g} m large, which no camera sees"
            raise DataError(f"{where}: pose: {what}; expected a translation in metres, and the model's unit")
        if self.frame == WORLD and tagged:
            return
        if points[:, 2].max() <= 0.0:
            what = (
                "the object is behind the camera; expected it before it, the third number of the translation forwards"
            )
            raise DataError(f"{where}: pose: {what}")
        if size_m > _INSIDE * away_m:
            what = (
                f"the object is {size_m:.3g} m large and {away_m:.3g} m away, all about the camera; is its unit right?"
            )
            _LOG.warning("%s: %s", where, what)


def read_objects(path: Path) -> ObjectsFile:
    """The objects of a file. Raises DataError, with the field and what was expected: it is missing or damaged."""
    content = read_yaml(path, _EXPECTED)
    _check_names(f"{path}", content, ("camera", "objects"))
    told = content.get("camera")
    camera = None if told is None else _pose(f"{path}: camera", told)
    entries = content.get("objects")
    if not isinstance(entries, list) or not 0 < len(entries) <= MAX_OBJECTS:
        raise DataError(f"{path}: objects: expected a list of 1 to {MAX_OBJECTS} objects")
    frames = [_frame(f"{path}: objects[{at}]", entry) for at, entry in enumerate(entries)]
    frame = WORLD if WORLD in frames else CAMERA
    objects: list[FirstPose] = []
    models = []
    for at, entry in enumerate(entries):
        where = f"{path}: objects[{at}]"
        number, pose = entry.get("id"), entry.get("pose")
        if type(number) is not int or not 1 <= number <= MAX_OBJECTS:
            raise DataError(f"{where}: id: expected a whole number from 1 to {MAX_OBJECTS}, got {number!r:.40}")
        if any(each["id"] == number for each in objects):
            raise DataError(f"{where}: id: {number} is there twice; expected a number of its own for each object")
        placed = None if pose is None else _pose(f"{where}: pose", pose)
        if placed is not None and frames[at] != frame and camera is not None:
            placed = camera @ placed
        objects.append({"id": number, "obj_id": number, "pose": placed})
        models.append((_model(where, path, entry), _unit(where, entry), entry))
    mixed = frame == WORLD and CAMERA in frames
    return ObjectsFile(path, tuple(objects), frame, mixed, camera, tuple(models))


def _check_names(where: str, entry: Any, known: tuple[str, ...]) -> None:
    if not isinstance(entry, dict):
        raise DataError(f"{where}: expected a map with {', '.join(known)}")
    wrong = [name for name in entry if name not in known]
    if wrong:
        raise DataError(f"{where}: {wrong[0]!r:.40}: expected one of {', '.join(known)}")


def _frame(where: str, entry: Any) -> str | None:
    """In which frame an object's pose is told; None: it is not."""
    _check_names(where, entry, _FIELDS)
    frame = entry.get("frame", CAMERA)
    if frame not in (CAMERA, WORLD):
        raise DataError(f"{where}: frame: expected {CAMERA} or {WORLD}, got {frame!r:.40}")
    if "pose" not in entry:
        raise DataError(f"{where}: pose: expected 4 rows of 4 numbers, or null for an object that is looked for")
    return None if entry["pose"] is None else str(frame)


def _pose(where: str, rows: object) -> Floats:
    matrix = read_matrix(where, rows)
    exact = np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() < 1e-12
    return matrix if exact else orthonormal(matrix)


def _model(where: str, path: Path, entry: dict[str, Any]) -> Path:
    model = entry.get("model")
    if not isinstance(model, str) or not model:
        raise DataError(f"{where}: model: expected a file beside {path.name}, got {model!r:.40}")
    return path.parent / model


def _unit(where: str, entry: dict[str, Any]) -> float:
    unit = entry.get("unit", "mm")
    if not isinstance(unit, str) or unit not in UNITS_M:
        raise DataError(f"{where}: unit: expected one of {', '.join(UNITS_M)}, got {unit!r:.40}")
    return UNITS_M[unit]
