"""Scene folders and results files of the BOP benchmark (https://bop.felk.cvut.cz).

A scene is ``DATASET/SPLIT/000001`` with ``scene_camera.json``, ``scene_gt.json`` and ``rgb/`` or ``gray/``; its models
are ``DATASET/models/obj_000001.ply`` (or ``.obj``, ``.stl``, ``.glb``, ``.gltf``) and ``models_info.json``. Lengths in
the files are millimetres, here metres. Of ``scene_gt.json`` nothing but the first frame is ever read."""

import os
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.sources.calibration import pinhole
from hierax.nodes.sources.files import DataError, read_numbers, writing
from hierax.nodes.sources.images import SUFFIXES as IMAGE_SUFFIXES
from hierax.nodes.sources.images import read_image
from hierax.nodes.sources.shots import is_rotation
from hierax.nodes.tracking.datasets import bop_json
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, make_pose
from hierax.nodes.tracking.model.files import BOP_UNIT_M, SUFFIXES, read_mesh
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.model.symmetry import found_symmetry
from hierax.nodes.tracking.schema import LOST, ScoredPose, Symmetry
from hierax.runtime.host.private_files import UnsafeFileError, open_result

TOLD_POSES = "scene_gt.json"
FIRST_POSES = "first_poses.json"  # of `hierax init`; read in the place of the former's

RESULTS_HEADER = "scene_id,im_id,obj_id,score,R,t,time"

_IMAGE_FOLDERS = ("rgb", "gray")

MAX_OBJECTS = 255  # in the first frame: each has its label in an image of 8 bits

_LEAST_M = 0.001  # from corner to corner of a model's box
_OFF = 10.0  # by this factor a model is larger or smaller than is said where one of both has another unit
_HUGE = 1e300

_FRAMES_AGAIN = 16  # how many of its last frames a results file can take back
_MAX_DIGITS = 9


class Frame(NamedTuple):
    """One image of a scene."""

    im_id: int  # its number in the scene
    image: Path  # the file
    intrinsics: Floats  # (4,) fx, fy, cx, cy in pixels
    camera: Floats  # world_from_camera; the identity where the scene gives no camera pose
    told: bool  # whether it does


class SceneObject(NamedTuple):
    """An object of the first frame."""

    id: int  # label in this scene, from 1 in the file's order
    obj_id: int  # number of its model
    pose: Floats | None  # camera_from_object in the first frame; None: it is not told


class BopScene:
    """A scene folder, ``DATASET/SPLIT/000001``. Reading the constructor's files checks them; images and models are read
    when asked for. Raises DataError: a file is missing or damaged; it is named."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise DataError(f"{self.folder}: no such folder; expected a BOP scene, DATASET/SPLIT/000001")
        self.scene_id = scene_number(self.folder)
        self.frames = self._read_frames()

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height of the first frame's image, which all others have to have. Raises DataError: the image is
        missing or damaged."""
        height, width = read_image(self.frames[0].image).shape[:2]
        return width, height

    def image(self, path: Path) -> Array:
        """The image of one of the frames, as `read_image` gives it. Raises DataError: it is missing or damaged, or has
        another size than the first one."""
        image = read_image(path)
        height, width = image.shape[:2]
        if (width, height) != self.size:
            expected = f"{self.size[0]}×{self.size[1]}, as the first frame has"
            raise DataError(f"{path}: has {width}×{height} pixels; expected {expected}")
        return image

    def first_objects(self, poses: bool = True) -> tuple[SceneObject, ...]:
        """The objects of the first frame with their poses there: the only truth that tracking starts from; of
        ``first_poses.json`` where a user gave some; poses: false: they are not read, and every object's is None, as is
        one that is null in the file. Raises DataError: ``scene_gt.json`` is missing or damaged."""
        names = (FIRST_POSES, TOLD_POSES) if poses else (TOLD_POSES, FIRST_POSES)
        path = next((path for name in names if (path := self.folder / name).exists()), self.folder / TOLD_POSES)
        first = str(self.frames[0].im_id)
        entries = bop_json.read_json(path).get(first)
        if not isinstance(entries, list) or not entries:
            raise DataError(f"{path}: frame {first}: expected a list of objects for the first frame")
        if len(entries) > MAX_OBJECTS:
            raise DataError(f"{path}: frame {first}: {len(entries)} objects; expected at most {MAX_OBJECTS}")
        return tuple(_scene_object(path, first, at, entry, poses) for at, entry in enumerate(entries))

    def model(self, obj_id: int, posed: bool = True) -> tuple[Mesh, Symmetry]:
        """A model, see `read_model`."""
        return read_model(self.models, obj_id, posed)

    @property
    def models(self) -> Path:
        """The folder of the models."""
        return dataset_of(self.folder) / "models"

    def _read_frames(self) -> tuple[Frame, ...]:
        path = self.folder / "scene_camera.json"
        cameras = bop_json.read_json(path)
        if not cameras:
            raise DataError(f"{path}: no frames")
        wrong = [key for key in cameras if not _is_number(key)]
        if wrong:
            raise DataError(f"{path}: {wrong[0]!r:.40} is no frame number; expected 0 to {bop_json.MAX_NUMBER}")
        if len({int(key) for key in cameras}) < len(cameras):
            raise DataError(f"{path}: a frame is there twice; expected an entry for each number")
        images = _image_files(self.folder)
        frames = []
        for key in sorted(cameras, key=int):
            im_id = int(key)
            if im_id not in images:
                kinds = ", ".join(suffix[1:] for suffix in IMAGE_SUFFIXES)
                expected = f"rgb/{im_id:06d}.png or gray/{im_id:06d}.png ({kinds})"
                raise DataError(f"{self.folder}: no image for frame {im_id}; expected {expected}")
            frames.append(_frame(path, key, cameras[key], images[im_id]))
        return tuple(frames)


def scene_number(folder: str | Path | None) -> int:
    """A BOP scene's number: its folder's name, where that is one; else 0."""
    name = Path(os.path.abspath(folder)).name if folder else ""
    return int(name) if name.isdecimal() else 0


def dataset_of(scene: Path) -> Path:
    """The folder of a scene's dataset, two above it, however that is named, as ``.`` and ``..``."""
    is_plain = len(scene.parts) > 2 and ".." not in scene.parts
    return (scene if is_plain else Path(os.path.abspath(scene))).parent.parent


def read_model(folder: Path, obj_id: int, posed: bool = True) -> tuple[Mesh, Symmetry]:
    """The mesh of a model, in metres, and its symmetry: as ``models_info.json`` has it, else as the mesh shows it; see
    `hierax.nodes.tracking.datasets.bop_json.read_symmetry`.
    Raises DataError: the model or ``models_info.json`` is missing or damaged, or one of them has another unit than
    millimetres: the model is next to nothing, or ten times as large as its ``diameter`` there, or a tenth of it."""
    info = folder / "models_info.json"
    entry = bop_json.read_json(info).get(str(obj_id))
    if not isinstance(entry, dict):
        raise DataError(f"{info}: no entry {str(obj_id)!r} for the object of that number")
    names = [folder / f"obj_{obj_id:06d}{suffix}" for suffix in SUFFIXES]
    path = next((name for name in names if name.exists()), names[0])
    mesh = read_mesh(path, BOP_UNIT_M)
    check_large(f"{path}", mesh)
    _check_diameter(path, mesh, f"{info}: {obj_id}", entry.get("diameter"))
    return mesh, bop_json.read_symmetry(f"{info}: {obj_id}", entry, posed) or found_symmetry(mesh)


def check_large(where: str, mesh: Mesh) -> None:
    """See that a model was not read in a unit that makes next to nothing of it. Raises DataError: it was."""
    size_m = box_diagonal_m(mesh)
    if size_m < _LEAST_M:
        told = f"the model is {1000.0 * size_m:.3g} mm large by it; expected at least {1000.0 * _LEAST_M:g} mm"
        raise DataError(f"{where}: unit: {told}")


def box_diagonal_m(mesh: Mesh) -> float:
    """How far it is through the box around a model, m."""
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def _check_diameter(path: Path, mesh: Mesh, where: str, diameter: Any) -> None:
    """See that a model is about as large as is said of it; where nothing is said, or no number, nothing is seen. Its
    box's diagonal is from one to √3 times its diameter. Raises DataError: it is not."""
    if type(diameter) not in (int, float) or not diameter > 0:
        return
    told, size = float(min(diameter, _HUGE)), box_diagonal_m(mesh) / BOP_UNIT_M
    if size < _OFF * told and np.sqrt(3.0) * told < _OFF * size:
        return
    sizes = f"the model is {size:.3g} mm large from corner to corner, its diameter in {where} is {told:.3g} mm"
    raise DataError(f"{path}: {sizes}; expected both in millimetres (of glTF models: metres)")


def check_no_results(path: Path, overwrite: bool = False) -> None:
    """See that nothing is lost where a results file is begun: there is no file, an empty one, or a header alone, as a
    process had begun that was killed; `overwrite`: or another results file. Raises DataError: there is one already, or
    something else, which is never replaced."""
    if not path.is_file():
        return
    header = RESULTS_HEADER.encode("ascii")
    try:
        with path.open("rb") as file:
            beginning = file.read(len(header) + 2)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}; expected a results file, or none") from error
    if beginning in (b"", header, header + b"\n"):
        return
    if beginning.split(b"\n")[0].rstrip() != header:
        raise DataError(f"{path}: is no results file, and is not replaced; name another file")
    if not overwrite:
        raise DataError(f"{path}: is there already; --overwrite replaces it, or name another file")


def _opened(path: Path, append: bool) -> FileIO:
    """A results file, to be gone on with at its end, or empty; a device as it is. Raises DataError: it is a link, or
    another user's."""
    if path.exists() and not path.is_file():
        return path.open("ab" if append else "wb", buffering=0)
    try:
        file = os.fdopen(open_result(path, append), "ab" if append else "wb", buffering=0)
    except UnsafeFileError as error:
        raise DataError(f"{error}; name another file") from error
    if not append:
        file.truncate(0)
    return file


class ResultsFile:
    """Writes a BOP results file: ``scene_id,im_id,obj_id,score,R,t,time``, one pose a line, after that header.

    R is nine numbers, row by row, and t three in millimetres, separated by spaces; time is the image's in seconds, -1
    where it is not known. An object that is lost has no line in that frame. A frame's lines are given to the system at
    once, and before `write` returns, so that they outlive the process.

    A frame that is written again takes the place of its earlier lines and of all behind
    them: whoever tells a frame again tells those after it again, too.

    Args: path: the file; its folder is created. scene_id: the scene's number. again: go on behind what another process
        has left there; a line that it did not finish is cut off. Else, or where there is no such file, one is begun, in
        the place of a results file that may be there.
    Raises DataError: the file cannot be written, now or later, or what is there is no results file, or a link."""

    def __init__(self, path: str | Path, scene_id: int, again: bool = False) -> None:
        self.path = Path(path)
        self._scene_id = scene_id
        if not again:
            check_no_results(self.path, overwrite=True)
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            written = self.path.read_bytes() if again and self.path.is_file() else b""
        self._end = written.rfind(b"\n") + 1
        self._begins = _last_frames(self.path, written[: self._end])
        with writing(self.path):
            self._file = _opened(self.path, append=self._end > 0)
            if 0 < self._end < len(written):
                self._cut(self._end)
            if not self._end:
                self._append(f"{RESULTS_HEADER}\n".encode("ascii"))

    def write(self, im_id: int, objects: Sequence[ScoredPose], time_s: float = -1.0) -> None:
        """One image's poses, and how long it took. Raises DataError: the file cannot be written."""
        lines = [self._line(im_id, item, time_s) for item in objects if item["status"] != LOST]
        with writing(self.path):
            while any(frame == im_id for frame, _ in self._begins):
                self._cut(self._begins.pop()[1])
            self._begins.append((im_id, self._end))
            self._append("".join(lines).encode("ascii"))

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def __enter__(self) -> "ResultsFile":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _line(self, im_id: int, item: ScoredPose, time_s: float) -> str:
        pose = item["pose"]
        rotation = " ".join(repr(float(part)) for part in pose[:3, :3].ravel())
        translation = " ".join(repr(float(part) / BOP_UNIT_M) for part in pose[:3, 3])
        head = f"{self._scene_id},{im_id},{item['obj_id']},{float(item['score'])!r}"
        return f"{head},{rotation},{translation},{time_s!r}\n"

    def _cut(self, end: int) -> None:
        self._file.truncate(end)
        self._file.seek(end)
        self._end = end

    def _append(self, lines: bytes) -> None:
        rest = memoryview(lines)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            self._cut(self._end)  # no half line is left for readers
            raise
        self._end += len(lines)


def _last_frames(path: Path, lines: bytes) -> deque[tuple[int, int]]:
    """Of a results file's last frames the number, and the offset in bytes at which each begins."""
    begins: deque[tuple[int, int]] = deque(maxlen=_FRAMES_AGAIN)
    head, *rest = lines.splitlines(keepends=True) or [RESULTS_HEADER.encode("ascii")]
    if head.rstrip() != RESULTS_HEADER.encode("ascii"):
        raise DataError(f"{path}, line 1: expected {RESULTS_HEADER}")
    offset = len(head)
    for number, line in enumerate(rest, start=2):
        try:
            im_id = int(line.split(b",")[1])
        except (ValueError, IndexError) as error:
            raise DataError(f"{path}, line {number}: expected {RESULTS_HEADER}") from error
        if not begins or begins[-1][0] != im_id:
            begins.append((im_id, offset))
        offset += len(line)
    return begins


class Result(NamedTuple):
    """One line of a results file; the pose is camera_from_object in metres."""

    scene_id: int
    im_id: int
    obj_id: int
    score: float
    pose: Floats
    time_s: float


def read_results(path: str | Path, growing: bool = False) -> list[Result]:
    """The lines of a BOP results file, in the file's order; a last line without its end is left out while the file is
    growing. Raises DataError: it is missing or empty, a line is damaged or has no rigid pose, or lines are of several
    scenes."""
    path = Path(path)
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}; expected a BOP results file") from error
    if not (text or growing):
        raise DataError(f"{path}: is empty; expected {RESULTS_HEADER}")
    rows: list[Result] = []
    for number, line in enumerate(text[: text.rfind("\n") + 1 if growing else None].splitlines(), start=1):
        if (number == 1 and line == RESULTS_HEADER) or not line.strip():
            continue
        fields = line.split(",")
        try:
            scene_id, im_id, obj_id = (int(part) for part in fields[:3])
            score, time_s = float(fields[3]), float(fields[6])
            rotation = np.array(fields[4].split(), dtype=np.float64).reshape(3, 3)
            translation = np.array(fields[5].split(), dtype=np.float64).reshape(3) * BOP_UNIT_M
        except (ValueError, IndexError) as error:
            raise DataError(f"{path}, line {number}: expected {RESULTS_HEADER}") from error
        _check_line(f"{path}, line {number}", rotation, (score, time_s, *translation))
        if rows and scene_id != rows[0].scene_id:
            told = f"scene {scene_id} in a file that begins with scene {rows[0].scene_id}"
            raise DataError(f"{path}, line {number}: {told}; expected one scene in a file")
        rows.append(Result(scene_id, im_id, obj_id, score, make_pose(rotation, translation), time_s))
    return rows


def _check_line(where: str, rotation: Floats, numbers: Sequence[float]) -> None:
    """See that a line of a results file has a rotation and finite numbers. Raises DataError: it has not."""
    if not np.isfinite(numbers).all():
        raise DataError(f"{where}: expected finite numbers as score, t and time")
    if not is_rotation(rotation):
        raise DataError(f"{where}: expected a rotation matrix as R, row by row")


def _is_number(text: str) -> bool:
    return text.isdecimal() and len(text) <= _MAX_DIGITS and int(text) <= bop_json.MAX_NUMBER


def _image_files(folder: Path) -> dict[int, Path]:
    for name in _IMAGE_FOLDERS:
        if not (folder / name).is_dir():
            continue
        found = sorted(path for path in (folder / name).iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        return {int(path.stem): path for path in reversed(found) if _is_number(path.stem)}
    raise DataError(f"{folder}: neither rgb/ nor gray/; expected a folder of images")


def _frame(path: Path, key: str, entry: Any, image: Path) -> Frame:
    where = f"{path}: frame {key}"
    intrinsics = pinhole(f"{where}: cam_K", read_numbers(where, entry, "cam_K", 9))
    told = "cam_R_w2c" in entry or "cam_t_w2c" in entry
    camera = invert(bop_json.read_pose(where, entry, "cam_R_w2c", "cam_t_w2c")) if told else np.eye(4)
    return Frame(int(key), image, intrinsics, camera, told)


def _scene_object(path: Path, frame: str, at: int, entry: Any, told: bool) -> SceneObject:
    where = f"{path}: frame {frame}, object {at}"
    number = bop_json.read_obj_id(where, entry)
    if "pose" in entry and entry["pose"] is not None:
        what = f"pose is {entry['pose']!r:.60}; expected null, or cam_R_m2c and cam_t_m2c in its place"
        raise DataError(f"{where}: {what}")
    if not told or "pose" in entry:
        return SceneObject(at + 1, number, None)
    return SceneObject(at + 1, number, bop_json.read_pose(where, entry, "cam_R_m2c", "cam_t_m2c"))
