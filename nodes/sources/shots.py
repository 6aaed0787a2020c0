"""What a source of frames gives: one interface for folders, videos, recordings, devices and streams."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.sources.files import DataError, read_numbers
from hierax.nodes.sources.images import MAX_PIXELS, Array

if TYPE_CHECKING:
    from hierax.nodes.sources.calibration import Lens

Floats = NDArray[np.float64]
Size = tuple[int, int]  # width and height in pixels

MAX_DISTANCE_M = 10_000.0
MAX_STAMP_NS = 2**31 * 10**9  # as ROS has times
_ROTATION_TOLERANCE = 1e-2


class Header(TypedDict):
    """What ROS says of a picture."""

    stamp_ns: int  # since 1970, mostly
    frame_id: str  # of the camera


class Told(TypedDict, total=False):
    """What goes with pictures of ROS alone."""

    header: Header


class Seen(TypedDict):
    """What every world believes that shows what a source gives."""

    index: int  # how many epochs it has shown before
    frame: int  # number of the newest frame, from 0; -1 before the first
    size: Size | None  # of the frames; None before the first where no calibration tells
    time_s: float  # of a live source the capture's, by the monotonic clock; else frames over frames per second
    wall_s: float | None  # of a live source the capture's, since 1970
    passed_over: int  # frames of a live source that newer ones displaced
    stalls: int  # epochs without a frame
    reopened: int  # how often a live source was opened anew
    ended: bool  # whether there is nothing left to show


class CameraBelief(Seen, Told):
    """What the world that shows a source's frames is."""

    # that frame, straightened, uint8 (h, w) gray or (h, w, 3) RGB, or uint16; None: none came for this epoch
    image: Array | None
    camera: Floats | None  # (4, 4) world_from_camera; None: nobody knows yet
    intrinsics: Floats  # (4,) fx, fy, cx, cy in pixels; zeros: nobody knows


class Shot(NamedTuple):
    """A frame as a source gives it, or that there is none."""

    frame: int  # its number; of none, the last one's
    image: Array | None  # as it was taken; None: there is none
    time_s: float
    wall_s: float | None = None
    passed_over: int = 0  # since the frame before
    reopened: int = 0  # how often the source was, in all
    ended: bool = False
    camera: Floats | None = None  # world_from_camera and fx, fy, cx, cy, where the source tells them
    intrinsics: Floats | None = None
    header: Header | None = None
    heard: Mapping[str, Any] | None = None  # of topics, in place of a picture
    place: str = ""  # of the frame alone, for errors; empty: that of the source


def ending(belief: Seen) -> Shot:
    """What follows the last frame."""
    return Shot(belief["frame"], None, belief["time_s"], ended=True)


class Source(ABC):
    """Where frames come from."""

    name: str  # for errors
    straight = False  # whether frames are straightened, and cameras told, already
    lens: "Lens | None" = None  # what it says itself of the lens that took its frames

    @abstractmethod
    def shot(self, belief: Seen) -> Shot:
        """What follows a belief. Raises DataError: it is damaged, or gives no frame where it should."""

    def close(self) -> None:
        """Nobody asks for a frame any more."""
        return


def lens_matrix(intrinsics: Array) -> Floats:
    """The pinhole camera's 3 × 3 matrix of fx, fy, cx, cy in pixels."""
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def check_size(name: str, image: Array, size: Size | None) -> None:
    """See that a frame is as large as it should be. Raises DataError: it is not; both sizes are named."""
    height, width = image.shape[:2]
    if width * height > MAX_PIXELS:
        raise DataError(f"{name}: has {width}×{height} pixels; expected at most {MAX_PIXELS} in all")
    if size is not None and (width, height) != size:
        expected = f"{size[0]}×{size[1]}, as the calibration or the frames before have"
        raise DataError(f"{name}: has {width}×{height} pixels; expected {expected}")


def is_rotation(matrix: Floats) -> bool:
    """Whether a 3 × 3 matrix is one, but for what rounding does."""
    turn = np.clip(matrix, -2.0, 2.0)  # of what is huge no product is to be had
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() <= _ROTATION_TOLERANCE and np.linalg.det(turn) > 0)


def read_matrix(where: str, rows: object) -> Floats:
    """A pose as a list of 4 rows of 4 numbers, metres. Raises DataError: it is none; `where` is told."""
    flat = [number for row in rows if isinstance(row, list) for number in row] if isinstance(rows, list) else None
    place, _, name = where.rpartition(": ")
    matrix = read_numbers(place, {name: flat}, name, 16).reshape(4, 4)
    if not is_rotation(matrix[:3, :3]) or (matrix[3] != [0.0, 0.0, 0.0, 1.0]).any():
        raise DataError(f"{where}: expected 4 rows of 4 numbers: a rotation, a translation, and 0, 0, 0, 1 below")
    if np.abs(matrix[:3, 3]).max() > MAX_DISTANCE_M:
        raise DataError(f"{where}: expected a translation in metres, at most {MAX_DISTANCE_M:g}")
    return matrix
