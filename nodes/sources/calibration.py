"""Calibrations of cameras, in the files that people have: ROS's camera_info in YAML, and OpenCV's YAML and XML.

The pinhole camera's coefficients are OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6[, s1 … s4[, τx, τy]]]] (ROS: plumb_bob,
rational_polynomial), the fisheye camera's k1 … k4 (ROS: equidistant). Straightened frames keep the camera matrix."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml

from hierax.nodes.sources.files import DataError, Loader, read_file, read_numbers, read_yaml, shown, write_whole
from hierax.nodes.sources.images import MAX_PIXELS, Array
from hierax.nodes.sources.shots import Floats, Size, lens_matrix

MIN_FOCAL_PX, MAX_FOCAL_PX = 1.0, 1e6
PINHOLE, RATIONAL, FISHEYE = "plumb_bob", "rational_polynomial", "equidistant"

_EXPECTED = "a calibration: ROS's camera_info as YAML, or OpenCV's YAML or XML"
_MATRIX = ("camera_matrix", "cameraMatrix", "K")
_COEFFICIENTS = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D")
_WIDTH, _HEIGHT = ("image_width", "width"), ("image_height", "height")
_MODEL = "distortion_model"
_DISTORTION = "dist"  # what begins so tells a distortion
_MODELS = {PINHOLE: (4, 5), RATIONAL: (8, 12, 14), FISHEYE: (4,), "fisheye": (4,), "": (0, 4, 5, 8, 12, 14)}
_MAX_COEFFICIENT = 1e6
_FOLD_CELLS = 128  # along the longer side of a picture, in which it is looked for folds


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera's calibration."""

    name: str  # where it comes from
    size: Size
    intrinsics: Floats  # (4,) fx, fy, cx, cy in pixels
    coefficients: Floats  # of the distortion
    fisheye: bool

    def straightened(self, image: Array) -> Array:
        """An image without the lens's distortion; what it does not show is black. One without any is given as it is."""
        if not self.coefficients.any() and not self.fisheye:
            return image
        between = cv2.INTER_LINEAR if image.dtype == np.uint8 else cv2.INTER_NEAREST  # depths are not mixed
        return np.asarray(cv2.remap(image, *self._maps, between))

    @property
    def matrix(self) -> Floats:
        """The camera's 3 × 3 matrix."""
        return lens_matrix(self.intrinsics)

    def folds(self) -> bool:
        """Whether, in the largest circle about the principal point, two places of the straight picture are one of the
        distorted one. In its corners a good calibration may, too: nobody has seen a board there."""
        scale = _FOLD_CELLS / max(self.size)
        size = (max(2, round(scale * self.size[0])), max(2, round(scale * self.size[1])))
        across, down = self._mapped(np.diag([scale, scale, 1.0]) @ self.matrix, size, cv2.CV_32FC1)
        centre = scale * self.intrinsics[2:]
        away = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1) - centre
        (across_down, across_across), (down_down, down_across) = np.gradient(across), np.gradient(down)
        upright = across_across * down_down > across_down * down_across
        bent = np.stack((across, down), axis=-1) - self.intrinsics[2:]
        on_its_side = (bent * away).sum(axis=-1) > 0.0
        distance = np.linalg.norm(away, axis=-1)
        inside = (distance > 1.0) & (distance < min(*centre, *(size - centre)))
        return not (upright & on_its_side)[inside].all()

    @cached_property
    def _maps(self) -> tuple[Array, Array]:
        return self._mapped(self.matrix, self.size, cv2.CV_16SC2)

    def _mapped(self, matrix: Floats, size: Size, kind: int) -> tuple[Array, Array]:
        """Where in the distorted picture each pixel of a straight one is that has another matrix and size."""
        make = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        maps = make(self.matrix, self.coefficients, np.eye(3), matrix, size, kind)
        return maps[0], maps[1]


def pinhole(where: str, numbers: Floats) -> Floats:
    """fx, fy, cx, cy of a camera matrix, row by row. Raises DataError: it is no pinhole camera's."""
    matrix = numbers.reshape(3, 3)
    focal, others = matrix[[0, 1], [0, 1]], np.abs(matrix - np.diag(np.diag(matrix)))
    if not (focal.min() > 0 and others[0, 1] <= 1e-6 * matrix[0, 0]):
        raise DataError(f"{where}: expected positive focal lengths and no skew")
    if not (focal.min() >= MIN_FOCAL_PX and focal.max() <= MAX_FOCAL_PX and others.max() <= MAX_FOCAL_PX):
        bounds = f"{MIN_FOCAL_PX:g} to {MAX_FOCAL_PX:g} pixels, and a principal point not further away"
        raise DataError(f"{where}: expected focal lengths of {bounds}")
    if others[1, 0] or others[2].any() or matrix[2, 2] != 1:
        raise DataError(f"{where}: expected [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])


def read_calibration(path: Path) -> Lens:
    """A camera's calibration. Raises DataError, with file, field and what was expected: it is missing or damaged."""
    return lens_of(str(path), _content(path))


def check_kind(path: Path) -> None:
    """See that a file is a calibration, of whatever lens. Raises DataError: it is missing, or something else."""
    content = _content(path)
    for names in (_WIDTH, _HEIGHT):
        _pixels(str(path), content, names)
    _matrix(str(path), content, _MATRIX)


def lens_of(path: str, content: Mapping[str, Any]) -> Lens:
    """The same of what is in a file, or in a message; `path`: what it is called in errors."""
    size = (_pixels(path, content, _WIDTH), _pixels(path, content, _HEIGHT))
    if size[0] * size[1] > MAX_PIXELS:
        raise DataError(f"{path}: image_width: expected at most {MAX_PIXELS} pixels in all, got {size[0]}×{size[1]}")
    name, values = _matrix(path, content, _MATRIX)
    intrinsics = pinhole(f"{path}: {name}", read_numbers(path, {name: values}, name, 9))
    model = content.get(_MODEL) or ("fisheye" if content.get("fisheye_model") in (1, "1", True) else "")
    if not isinstance(model, str) or model not in _MODELS:
        raise DataError(f"{path}: {_MODEL}: expected one of {', '.join(filter(None, _MODELS))}, got {shown(model)}")
    _check_keys(path, content)
    name, values = _matrix(path, content, _COEFFICIENTS, None if model else [])  # who names a model gives its numbers
    counts = _MODELS[model] if any(values) else {count for each in _MODELS.values() for count in each}
    if len(values) not in counts:
        numbers = " or ".join(map(str, _MODELS[model]))
        raise DataError(f"{path}: {name}: expected {numbers} numbers{model and f' of {model}'}, got {len(values)}")
    coefficients = read_numbers(path, {name: values}, name, len(values))
    if np.abs(coefficients).max(initial=0.0) > _MAX_COEFFICIENT:
        raise DataError(f"{path}: {name}: expected numbers of at most {_MAX_COEFFICIENT:g}")
    fisheye = model in (FISHEYE, "fisheye")
    if fisheye:
        coefficients = coefficients[:4]  # more are zeros, and OpenCV takes no more
    lens = Lens(path, size, intrinsics, coefficients if len(coefficients) else np.zeros(4), fisheye)
    if lens.folds():
        what = "bend the picture so far that parts of it lie upon others; expected those of a lens"
        raise DataError(f"{path}: {name}: {values!s:.60} {what}")
    return lens


def write_calibration(lens: Lens, path: Path) -> None:
    """Write a calibration as ROS's camera_info. Raises DataError: it cannot be written."""
    content = told_by(lens, path.stem)
    write_whole(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120).encode())


def told_by(lens: Lens, camera: str) -> dict[str, Any]:
    """A calibration as ROS's camera_info of a camera of this name."""
    count = len(lens.coefficients)
    projection = np.hstack([lens.matrix, np.zeros((3, 1))])
    return {
        "image_width": lens.size[0],
        "image_height": lens.size[1],
        "camera_name": camera,
        "camera_matrix": _plain(lens.matrix),
        _MODEL: FISHEYE if lens.fisheye else PINHOLE if count <= 5 else RATIONAL,
        "distortion_coefficients": _plain(lens.coefficients[None]),
        "rectification_matrix": _plain(np.eye(3)),
        "projection_matrix": _plain(projection),
    }


def _plain(matrix: Floats) -> dict[str, Any]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": matrix.ravel().tolist()}


def _found(content: Mapping[str, Any], names: tuple[str, ...]) -> str:
    return next((name for name in names if name in content), names[0])


def _check_keys(path: str, content: Mapping[str, Any]) -> None:
    """Raises DataError: something looks like a distortion, under a name by which nothing reads it."""
    for key in map(str, content):
        if key.lower().startswith(_DISTORTION) and key not in (*_COEFFICIENTS, _MODEL):
            raise DataError(
                f"{path}: {key:.40}: expected {_MODEL}, or the coefficients as {' or '.join(_COEFFICIENTS)}"
            )


def _pixels(path: str, content: Mapping[str, Any], names: tuple[str, ...]) -> int:
    name = _found(content, names)
    value = content.get(name)
    if type(value) is not int or not 0 < value <= MAX_PIXELS:
        raise DataError(f"{path}: {name}: expected a number of pixels, got {shown(value)}")
    return value


def _matrix(
    path: str, content: Mapping[str, Any], names: tuple[str, ...], otherwise: list[Any] | None = None
) -> tuple[str, list[Any]]:
    """The first of these that is there: its name and its numbers, row by row."""
    name = _found(content, names)
    value = content.get(name, otherwise)
    values = value.get("data") if isinstance(value, dict) else value
    if isinstance(values, list) and values and all(isinstance(row, list) for row in values):
        values = [number for row in values for number in row]
    if not isinstance(values, list):
        raise DataError(f"{path}: {name}: expected a matrix with rows, cols and data")
    return name, values


def _content(path: Path) -> dict[str, Any]:
    return _read_xml(path) if path.suffix.lower() == ".xml" else read_yaml(path, _EXPECTED)


def _read_xml(path: Path) -> dict[str, Any]:
    """OpenCV's XML, as its YAML would be read."""
    try:
        root = ElementTree.fromstring(read_file(path, _EXPECTED))
    except ElementTree.ParseError as error:
        raise DataError(f"{path}, line {error.position[0]}: no XML ({error}); expected {_EXPECTED}") from error
    except (LookupError, ValueError) as error:  # of its encoding
        raise DataError(f"{path}: no XML ({error}); expected {_EXPECTED}") from error
    return {entry.tag: _xml_value(path, entry) for entry in root}


def _xml_value(path: Path, entry: ElementTree.Element) -> Any:
    """A matrix, a number or a word; of a text of several words, which tells nothing of a lens, an empty one."""
    data = entry.find("data")
    words = ((entry if data is None else data).text or "").split()
    if data is None and len(words) != 1:
        return ""
    try:
        values = [yaml.load(word, Loader) for word in words]
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if data is None:
            return words[0]
        raise DataError(f"{path}: {entry.tag}: cannot be read; expected numbers with blanks between them") from error
    return values[0] if data is None else {"data": values}
