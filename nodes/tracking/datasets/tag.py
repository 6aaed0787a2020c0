"""Where a camera is, told by a tag that lies on the table: an AprilTag or an ArUco marker.

The world's frame is then the tag's: its origin the tag's centre, x to the right and y to the top of the tag as it is
read, z out of it, so that the table is the plane z = 0."""

from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

import cv2
import numpy as np

from hierax.nodes.sources.boards import FAMILIES
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.shots import lens_matrix
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.errors import check_between
from hierax.nodes.tracking.estimation.profiles import light_of
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, make_pose, project, transform

FAMILY = "36h11"
_PICTURES = 300  # so many are looked at for the first one that shows it
_CELL_PX = 16  # of the tag as it is compared with the picture
_ROUNDS, _SAMPLES, _BLUR_PX = 3, 2, 0.7  # how often it is drawn anew where it was found, in how many samples, how soft
_AROUND_PX = 12
_RIVAL = 2.0  # a plane may be seen tilted either way; by so much one of the two has to fit better
_STILL_PX = 0.5  # a camera from which the tag's corners seem to move by less stands still


class Tag(NamedTuple):
    """A tag on the table."""

    side_m: float  # of its black square
    family: str  # as `FAMILIES` names it
    number: int | None  # None: the only one that is seen


class Seen(NamedTuple):
    """A tag in a picture."""

    number: int
    camera: Floats  # tag_from_camera


def tag_of(side_mm: float | None, name: str = FAMILY) -> Tag | None:
    """A tag as options tell it, by the side of its black square and its family, ``36h11``, or that with its number,
    ``36h11:3``; None where there is no side. Raises ValueError: the side is not from 1 to 10 000, there is no such
    family, or no such number in it."""
    family, _, number = name.lower().partition(":")
    if family not in FAMILIES or not (number.isdecimal() or family == name.lower()):
        raise ValueError(f"tag is {name!r}; expected FAMILY or FAMILY:NUMBER, of the families {', '.join(FAMILIES)}")
    if number:
        check_between(0, len(_dictionary(family).bytesList) - 1, f"a number of the family {family}", tag=int(number))
    if side_mm is None:
        return None
    check_between(1, 10_000, "millimetres", tag_mm=side_mm)
    return Tag(side_mm / 1000.0, family, int(number) if number else None)


class TagCamera:
    """Where the camera of a scene is, by a tag.

    The first picture that shows the tag tells where the world is that the scene's camera poses are told in. Where none
    is told, each picture tells the camera's pose; one that does not show the tag leaves the camera where it was. Raises
    DataError: no picture shows it, or one shows several that it may be."""

    def __init__(self, scene: BopScene, tag: Tag) -> None:
        self._scene = scene
        for frame in islice(scene.frames, _PICTURES):
            found = find(tag, scene.image(frame.image), frame.intrinsics, f"{frame.image}")
            if found is not None:
                self._tag = tag._replace(number=found.number)
                self._world = found.camera @ invert(frame.camera)
                return
        name = tag.family if tag.number is None else f"{tag.family}:{tag.number}"
        looked = min(len(scene.frames), _PICTURES)
        unseen = f"{scene.folder}: no tag {name} is seen well enough in its first {looked} pictures"
        raise DataError(f"{unseen}; expected one that lies on the table, with white around it")

    def first(self) -> Floats:
        """world_from_camera of the first frame."""
        return self._world @ self._scene.frames[0].camera

    def at(self, index: int, image: Array, before: Floats) -> Floats:
        """world_from_camera of the frame at an index after the first one, by its picture and by that of the frame
        before."""
        frame = self._scene.frames[index]
        if frame.told:
            return self._world @ frame.camera
        camera = locate(self._tag, image, frame.intrinsics, before, f"{frame.image}")
        return before if camera is None else camera


@lru_cache(maxsize=4)
def tag_camera(folder: str, tag: Tag) -> TagCamera:
    """The camera of a scene folder, made once."""
    return TagCamera(BopScene(folder), tag)


def locate(tag: Tag, image: Array, intrinsics: Array, before: Floats | None, where: str) -> Floats | None:
    """world_from_camera by the tag in a picture; where it is not seen, or the camera stands still, as it was before.

    Args: as for `find`; before: world_from_camera of the picture before, or None."""
    found = find(tag, image, intrinsics, where)
    if found is None or before is None:
        return before if found is None else found.camera
    corners = _corners(tag.side_m)
    held, now = (project(transform(invert(each), corners), intrinsics) for each in (before, found.camera))
    return before if np.abs(held - now).max() < _STILL_PX else found.camera


def find(tag: Tag, image: Array, intrinsics: Array, where: str) -> Seen | None:
    """The tag in a picture, uint8, (h, w) gray or (h, w, 3) RGB, of a camera of fx, fy, cx, cy in pixels; None where it
    is not seen, or so flat that it may be tilted either way. Raises DataError: several are seen that it may be; says
    where that is."""
    light = light_of(image)
    grey = light if light.ndim == 2 else light.mean(axis=2)
    read = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    squares, numbers, _ = _detector(tag.family).detectMarkers(read)
    seen = [
        (int(number), square.reshape(4, 2).astype(np.float64))
        for square, number in zip(squares, () if numbers is None else numbers.ravel(), strict=True)
        if tag.number in (None, int(number))
    ]
    if len(seen) > 1:
        told = ", ".join(str(number) for number, _ in seen)
        raise DataError(f"{where}: shows several tags: {tag.family} {told}; expected one, or tag={tag.family}:NUMBER")
    if not seen:
        return None
    number, square = seen[0]
    pixels = _fitted(_pattern(tag.family, number), grey, square)
    pose = None if pixels is None else _pose(pixels, tag.side_m, intrinsics)
    return None if pose is None else Seen(number, invert(pose))


def _pose(pixels: Floats, side_m: float, intrinsics: Array) -> Floats | None:
    """camera_from_tag of its corners in the picture."""
    corners, lens = _corners(side_m), lens_matrix(intrinsics)
    count, turns, shifts, errors = cv2.solvePnPGeneric(corners, pixels, lens, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    if not count or not (np.ravel(shifts[0])[2] > 0.0):
        return None
    poses = [make_pose(cv2.Rodrigues(turn)[0], np.ravel(shift)) for turn, shift in zip(turns, shifts, strict=True)]
    if count > 1 and float(np.ravel(errors[1])[0]) < _RIVAL * float(np.ravel(errors[0])[0]):
        return None
    return poses[0]


def _corners(side_m: float) -> Floats:
    """(4, 3) from the top left on, clockwise."""
    half = 0.5 * side_m
    return half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def _fitted(pattern: Array, light: Array, square: Floats) -> Floats | None:
    """A tag's corners (4, 2) in a picture's light, from where they are about, by all of its pixels: its pattern is
    drawn as it should be seen, and moved."""
    low = np.maximum(np.floor(square.min(axis=0)).astype(int) - _AROUND_PX, 0)
    high = np.minimum(np.ceil(square.max(axis=0)).astype(int) + _AROUND_PX, light.shape[::-1])
    part = np.ascontiguousarray(light[low[1] : high[1], low[0] : high[0]])
    size = part.shape[1], part.shape[0]
    inner, outer = _CELL_PX // 2 - 0.5, len(pattern) - _CELL_PX // 2 - 0.5
    corners = np.array([[inner, inner], [outer, inner], [outer, outer], [inner, outer]], dtype=np.float32)
    finer = np.array([[_SAMPLES, 0, _SAMPLES / 2 - 0.5], [0, _SAMPLES, _SAMPLES / 2 - 0.5], [0, 0, 1]])
    layers = cv2.merge([pattern, np.ones_like(pattern)])
    pixels = square - low
    ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-5)
    for _ in range(_ROUNDS):
        to_pixels = finer @ cv2.getPerspectiveTransform(corners, pixels.astype(np.float32))
        drawn = cv2.warpPerspective(layers, to_pixels, (size[0] * _SAMPLES, size[1] * _SAMPLES))
        drawn, there = cv2.split(cv2.resize(drawn, size, interpolation=cv2.INTER_AREA))
        soft = cv2.GaussianBlur(drawn, (0, 0), _BLUR_PX)
        mask = cv2.erode((there > 0.99).astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
        try:
            _, step = cv2.findTransformECC(soft, part, np.eye(3, dtype="f4"), cv2.MOTION_HOMOGRAPHY, ends, mask, 1)
        except cv2.error:  # nothing of it is like the picture
            return None
        pixels = cv2.perspectiveTransform(pixels[None], step.astype(np.float64))[0]
    return np.asarray(pixels + low, dtype=np.float64)


@lru_cache(maxsize=16)
def _pattern(family: str, number: int) -> Array:
    """A tag's light, 0 to 1, with half a cell of white around it."""
    dictionary = _dictionary(family)
    cells = dictionary.markerSize + 2
    tag = cv2.aruco.generateImageMarker(dictionary, number, cells * _CELL_PX).astype(np.float32) / 255.0
    return np.asarray(np.pad(tag, _CELL_PX // 2, constant_values=1.0))


@lru_cache(maxsize=4)
def _detector(family: str) -> Any:
    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(_dictionary(family), options)


def _dictionary(family: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(FAMILIES[family])
