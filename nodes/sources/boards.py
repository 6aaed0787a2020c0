"""A camera's calibration from pictures of a board: a chessboard, or a ChArUco board."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.sources.calibration import FISHEYE, PINHOLE, RATIONAL, Lens, lens_of, told_by
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import Array
from hierax.nodes.sources.shots import Floats, Size, check_size

FAMILIES = {
    name.removeprefix("DICT_").removeprefix("APRILTAG_").lower(): getattr(cv2.aruco, name)
    for name in dir(cv2.aruco)
    if name.startswith("DICT_")
}
"""OpenCV's dictionaries of markers, ArUco's and AprilTag's, by name."""

MODELS = (PINHOLE, RATIONAL, FISHEYE)
LEAST_VIEWS = 5
MAX_VIEWS = 60  # of more the calibration takes minutes, and is no better
_LEAST_CORNERS = 8  # of a ChArUco board that is seen in part
_NEW_SHARE = 0.02  # of the picture's width, by which corners moved in the mean since a view that is another one
_OUTLYING = 3.0  # times the median of the views' errors: left out, and calibrated again
_CELLS = (8, 6)  # of the picture, for how much of it the corners cover


class View(NamedTuple):
    """The corners of the board in a picture."""

    numbers: NDArray[np.int64]  # (n,) of the corners
    corners: Floats  # (n, 1, 3) metres, on the board
    pixels: Floats  # (n, 1, 2)


@dataclass(frozen=True)
class Board:
    """A board: its inner corners in columns and rows, and the side of a square in metres; of a ChArUco board the
    squares in columns and rows, its markers' side in metres, and OpenCV's dictionary of them."""

    columns: int
    rows: int
    square_m: float
    marker_m: float | None = None
    dictionary: Any = None

    def detector(self) -> Callable[[Array], View | None]:
        """What finds the board in a picture."""
        if self.marker_m is None:
            return self._chessboard
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, self.dictionary)
        points, detector = np.asarray(board.getChessboardCorners(), np.float32), cv2.aruco.CharucoDetector(board)

        def charuco(grey: Array) -> View | None:
            pixels, numbers, _, _ = detector.detectBoard(grey)
            if numbers is None or len(numbers) < _LEAST_CORNERS:
                return None
            at = numbers.ravel().astype(np.int64)
            lines = {tuple(np.unique(points[at, axis]).tolist()) for axis in (0, 1)}
            if min(map(len, lines)) < 3:  # almost on a line, which says nothing
                return None
            return _view(at, points[at], pixels)

        return charuco

    def _chessboard(self, grey: Array) -> View | None:
        size = (self.columns, self.rows)
        quick = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        good, rough = cv2.findChessboardCorners(grey, size, flags=quick)
        if not good:
            return None
        number = np.arange(self.columns * self.rows)
        flat = np.stack([number % self.columns, number // self.columns, 0 * number], axis=1)
        return _view(number, self.square_m * flat, _refined(grey, rough))


def _refined(grey: Array, rough: Array) -> Array:
    """Corners (n, 1, 2), each by what is nearer to it than the next one."""
    rough = rough.reshape(-1, 1, 2)
    apart = np.linalg.norm(rough - rough[:, 0], axis=2) + np.diag(np.full(len(rough), np.inf))
    window = max(2, int(0.4 * apart.min()))
    ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    return np.asarray(cv2.cornerSubPix(grey, rough, (window, window), (-1, -1), ends))


def _view(numbers: Array, corners: Array, pixels: Array) -> View:
    return View(numbers, corners.astype(np.float64).reshape(-1, 1, 3), pixels.astype(np.float64).reshape(-1, 1, 2))


class Calibration(NamedTuple):
    """What pictures of a board tell of a camera."""

    lens: Lens
    rms_px: float  # of the corners, in the views that were used
    views: Sequence[View]  # those
    left_out: int  # how many did not fit

    @property
    def covered(self) -> float:
        """Of the picture's cells the share in which there was a corner."""
        cells = np.floor(_pixels(self.views) * _CELLS / self.lens.size).astype(int).clip(0, np.array(_CELLS) - 1)
        return len(np.unique(cells, axis=0)) / (_CELLS[0] * _CELLS[1])

    def picture(self) -> Array:
        """The corners of all views over the picture, RGB: where there are none, nobody knows the distortion."""
        width, height = self.lens.size
        picture = np.full((height, width, 3), 255, np.uint8)
        for view, hue in zip(self.views, np.linspace(0, 170, len(self.views)), strict=True):
            colour = cv2.cvtColor(np.array([[[hue, 255, 200]]], np.uint8), cv2.COLOR_HSV2RGB)[0, 0].tolist()
            for pixel in np.rint(view.pixels[:, 0]).astype(int).tolist():
                cv2.circle(picture, pixel, max(2, width // 200), colour, -1, cv2.LINE_AA)
        return picture


def find_views(
    name: str, board: Board, pictures: Iterable[Array], most: int, found: Callable[[int, int], None]
) -> tuple[list[View], Size]:
    """The board in pictures, of which each shows it elsewhere; and their size.

    Args:
        name: what the pictures are called; most: of the views, enough of them.
        found: hears after each picture how many there were, and how many views.

    Raises DataError: there is no picture, or one has another size."""
    detect, size = board.detector(), None
    views: list[View] = []
    for count, picture in enumerate(pictures, start=1):
        check_size(name, picture, size)
        size = (picture.shape[1], picture.shape[0])
        view = detect(picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
        if view is not None and all(_apart(view, other) > _NEW_SHARE * size[0] for other in views):
            views.append(view)
        found(count, len(views))
        if len(views) >= most:
            break
    if size is None:
        raise DataError(f"{name}: no pictures; expected some that show the board")
    return views, size


def calibrate(name: str, views: Sequence[View], size: Size, model: str = PINHOLE) -> Calibration:
    """A camera's calibration from views of a board, without those that do not fit the others.

    Args: name: what the pictures are called; model: one of `MODELS`.
    Raises DataError: there are too few views, or they tell no camera, or a lens that is refused where it is read."""
    if len(views) < LEAST_VIEWS:
        what = f"the board is seen in {len(views)} different ways; expected at least {LEAST_VIEWS}"
        raise DataError(f"{name}: {what}, tilted, near and far, and a look at --board")
    try:
        lens, errors = _fitted(name, views, size, model)
        good = [view for view, error in zip(views, errors, strict=True) if error <= _OUTLYING * np.median(errors)]
        if LEAST_VIEWS <= len(good) < len(views):
            lens, errors = _fitted(name, good, size, model)
        else:
            good = list(views)
    except cv2.error as error:
        what = "these views tell no camera; expected the board tilted, near and far, all over the picture"
        raise DataError(f"{name}: {what}") from error
    try:
        lens_of(name, told_by(lens, name))
    except DataError as error:
        what = "these views tell no lens that there is; expected the board near the picture's corners, too"
        raise DataError(f"{name}: {what} ({str(error).removeprefix(f'{name}: ')})") from error
    counts = np.array([len(view.numbers) for view in good])
    return Calibration(lens, float(np.sqrt(np.sum(errors**2 * counts) / counts.sum())), good, len(views) - len(good))


def _fitted(name: str, views: Sequence[View], size: Size, model: str) -> tuple[Lens, Floats]:
    """The lens, and each view's rms in pixels."""
    if model == FISHEYE:
        points, pixels = ([each.reshape(1, *each.shape[::2]) for each in part] for part in _parts(views))
        flags = _flag("CALIB_RECOMPUTE_EXTRINSIC") | _flag("CALIB_FIX_SKEW") | cv2.CALIB_USE_INTRINSIC_GUESS
        half = size[0] / 2.0
        guess = np.array([[half, 0.0, half], [0.0, half, size[1] / 2.0], [0.0, 0.0, 1.0]])
        ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
        found = cv2.fisheye.calibrate(points, pixels, size, guess, np.zeros(4), None, None, flags, ends)
    else:
        single: Any = [[each.astype(np.float32) for each in part] for part in _parts(views)]
        flags = cv2.CALIB_RATIONAL_MODEL if model == RATIONAL else 0
        make: Any = cv2.calibrateCamera  # its annotation lacks that it makes the first guess
        found = make(*single, size, None, None, flags=flags)
    _, matrix, bend, turns, shifts = found
    errors = []
    for view, turn, shift in zip(views, turns, shifts, strict=True):
        project = cv2.fisheye.projectPoints if model == FISHEYE else cv2.projectPoints
        seen, _ = project(view.corners, turn, shift, matrix, bend)
        errors.append(float(np.sqrt(np.mean(np.sum((seen.reshape(-1, 2) - view.pixels[:, 0]) ** 2, axis=1)))))
    intrinsics = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
    coefficients = np.ravel(bend)[: 8 if model == RATIONAL else 5].astype(np.float64)
    if not (np.isfinite(intrinsics).all() and np.isfinite(coefficients).all() and intrinsics[:2].min() > 0):
        raise DataError(f"{name}: these views tell no camera; expected the board tilted, near and far")
    return Lens(name, size, intrinsics, coefficients, model == FISHEYE), np.array(errors)


def _parts(views: Sequence[View]) -> tuple[list[Floats], list[Floats]]:
    return [view.corners for view in views], [view.pixels for view in views]


def _flag(name: str) -> int:
    """One of the fisheye's, which are elsewhere since OpenCV 5."""
    return int(getattr(cv2, name, None) or getattr(cv2.fisheye, name))


def _apart(view: View, other: View) -> float:
    """How far the corners that two views share are apart, in the mean, in pixels; nothing shared is far."""
    _, mine, its = np.intersect1d(view.numbers, other.numbers, return_indices=True)
    if not len(mine):
        return float("inf")
    return float(np.linalg.norm(view.pixels[mine, 0] - other.pixels[its, 0], axis=1).mean())


def _pixels(views: Sequence[View]) -> Floats:
    return np.concatenate([view.pixels[:, 0] for view in views])
