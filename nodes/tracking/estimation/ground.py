"""What the table's texture says of the camera: an older image of it, beside the newest one.

Points of a plane are where a homography takes them from one image to another, and that follows from where the camera was over
the plane in both. So an image tells how the camera has moved since an older one, and, as soon as it has moved, how it is tilted
towards the table: what the objects' edges alone tell but roughly, as each of them may be tilted a little, too. How high the camera is
the texture does not say. The older camera's error is part of what is estimated (stochastic cloning: Roumeliotis and
Burdick, 2002), as what both images have in common tells of both.

Patches about corners of the older image are found in the newest one, which is first taken back to the older view (Lucas and
Kanade, 1981; OpenCV's). What moves otherwise, as what stands on the table does, is left out by Tukey's weight."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.fusion import Rows
from hierax.nodes.tracking.math.batched import exp_many, inverse
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_se3, invert, rays
from hierax.nodes.tracking.schema import Ground, Imagery, Texture

_HALF = 20  # pixels from the middle of a patch to its end
_CELL = 8  # pixels of a side of what is covered, or is not
_STEP = 1e-5  # m and rad, of derivatives
_STEPS = _STEP * np.concatenate((np.eye(12), -np.eye(12)))
_REACH = 7  # pixels from the middle of a window that is looked for to its end
_WINDOW = (2 * _REACH + 1, 2 * _REACH + 1)
_ITERATIONS = 5
_MEDIAN = 1.386  # of the squared length of what is normally distributed in two dimensions

Gray = NDArray[np.uint8]


class Said(NamedTuple):
    """What the texture says: a quadratic around no error."""

    information: Floats  # (12, 12) of the camera's error in this image and in the older one, twists in their frames
    right: Floats  # (12,) that, times the errors of which it speaks
    share: float  # of the points in the older image, how many are found


class Told(NamedTuple):
    """`hierax.nodes.tracking.estimation.fusion.Prior`'s fields of these names, when the texture was seen."""

    joint: Floats
    mean: Floats | None
    older: slice | None


class TableSeen:
    """The table in one image: what that says of the camera, and what is kept of it.

    Args: gray: (h, w); camera: world_from_camera as it is expected, where z = 0 is the table; texture: what is known."""

    def __init__(self, gray: Gray, camera: Floats, intrinsics: Array, texture: Texture) -> None:
        self._gray, self._camera, self._intrinsics, self._texture = gray, camera, intrinsics, texture
        self._newer: Ground | None = None

    def told(self, joint: Floats) -> Told:
        """What is known of the camera and all objects with it, as `hierax.nodes.tracking.estimation.drift.joint_of` has
        that without it."""
        ground, said, mean = self._texture["ground"], None, None
        if ground is not None:
            up = ground["camera"][2, :3]
            joint = np.array(joint)
            joint[-6:-3, -6:-3] += const.RESTING_M**2 * np.outer(up, up)
            rows = np.r_[Rows.error, len(joint) - 6 : len(joint)]
            spread = joint[np.ix_(rows, rows)]
            said = said_by(self._gray, ground, self._camera, self._intrinsics, self._texture["covered"], spread)
            if said is not None:
                gain = (
                    joint[:, rows] @ np.linalg.solve((np.eye(12) + spread @ said.information).T, said.information.T).T
                )
                joint = joint - gain @ joint[rows]
                joint = 0.5 * (joint + joint.T)
                mean = joint[:, rows] @ said.right
        if said is None or said.share < const.TEXTURE_KEPT:
            self._newer = ground_of(self._gray, self._camera, self._intrinsics, self._texture["covered"])
        if self._newer is not None:
            return Told(joint, mean, Rows.error)
        return Told(joint, mean, None if ground is None else slice(len(joint) - 6, len(joint)))

    def after(self, camera: Floats, older: Floats) -> Texture:
        """What is known from then on; camera: as it turned out, older: by how much that of the older image erred."""
        ground = self._texture["ground"]
        if self._newer is not None:
            return {**self._texture, "ground": {**self._newer, "camera": camera}}
        if ground is None:
            return self._texture
        return {**self._texture, "ground": {**ground, "camera": ground["camera"] @ exp_se3(-older)}}


def gray_of(image: Array) -> Gray:
    """(h, w) of a picture (h, w) or (h, w, 3)."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def covered_by(imagery: Imagery) -> Gray:
    """(h / 8, w / 8) where bodies are expected, and next to them; 1 there."""
    width, height = imagery["size"]
    left, top = imagery["corner"]
    rows, columns = imagery["labels"].shape
    whole = np.zeros((height, width), dtype=np.uint8)
    whole[top : top + rows, left : left + columns] = imagery["labels"] > 0
    size = (-(-width // _CELL), -(-height // _CELL))
    coarse = cv2.resize(whole * np.uint8(255), size, interpolation=cv2.INTER_AREA) > 0
    return np.asarray(cv2.dilate(coarse.astype(np.uint8), np.ones((5, 5), dtype=np.uint8)))


def ground_of(gray: Gray, camera: Floats, intrinsics: Array, covered: Gray) -> Ground | None:
    """Corners of the table's texture; camera: world_from_camera, where z = 0 is the table. None: there are too few."""
    height, width = gray.shape
    cells = np.stack(np.meshgrid(*(np.arange(count) for count in covered.shape[::-1])), axis=-1)
    towards = rays(_CELL * (cells + 0.5), intrinsics) @ camera[2, :3]
    near = -towards * const.TEXTURE_FAR > 1.0
    free = (near & (covered == 0)).astype(np.uint8).repeat(_CELL, axis=0).repeat(_CELL, axis=1)[:height, :width]
    inside = np.zeros_like(free)
    inside[_HALF:-_HALF, _HALF:-_HALF] = free[_HALF:-_HALF, _HALF:-_HALF]
    found = cv2.goodFeaturesToTrack(gray, const.TEXTURE_POINTS, const.TEXTURE_CORNER, _HALF, mask=inside, blockSize=7)
    if found is None or len(found) < const.LEAST_SHOWN:
        return None
    points = np.rint(found[:, 0]).astype(np.int64)
    return {"camera": camera, "points": points, "patches": gray[_pixels(points)]}


def said_by(
    gray: Gray, ground: Ground, camera: Floats, intrinsics: Array, covered: Gray, spread: Floats
) -> Said | None:
    """What an image says; camera: as it is expected, spread: (12, 12) covariance of its error and the older one's.
    None: too little of the texture is found."""
    patches, points = ground["patches"], ground["points"]
    canvas = np.zeros_like(gray)
    canvas[_pixels(points)] = patches
    slopes = _structure(patches)
    errors = np.zeros(12)
    for reach in (1, 0):  # pyramid levels: near first, then exactly
        back = _homographies(camera, ground["camera"], errors[None], intrinsics)[0]  # to this image
        shown = _shown(points, back, covered, gray.shape)
        if shown.sum() < const.LEAST_SHOWN:
            return None
        seen = cv2.warpPerspective(gray, back, gray.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        start = points[shown].astype(np.float32)
        bright = float(np.mean(canvas[points[shown, 1], points[shown, 0]]) or 1.0)
        gain = float(np.mean(seen[points[shown, 1], points[shown, 0]])) / bright
        like = cv2.convertScaleAbs(canvas, alpha=gain)
        ends, found, _ = cv2.calcOpticalFlowPyrLK(
            like, seen, start, start.copy(), winSize=_WINDOW, maxLevel=reach, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
        )
        off = (ends - start).astype(np.float64)
        kept = (found[:, 0] == 1) & (np.abs(off).max(axis=1) < _REACH)
        if kept.sum() < const.LEAST_SHOWN:
            return None
        rows = np.nonzero(shown)[0][kept]
        leads = _derivatives(camera, ground["camera"], errors, intrinsics, points[rows])
        fit = _fitted(off[kept], leads, slopes[rows], inverse(spread), errors)
        errors = fit.errors
    share = fit.found / len(points)
    if fit.found < const.LEAST_SHOWN or fit.found < const.TEXTURE_KEPT * shown.sum():
        return None
    return Said(fit.information, fit.right, share)


class _Fit(NamedTuple):
    errors: Floats  # (12,)
    information: Floats  # (12, 12)
    right: Floats  # (12,)
    found: int


def _fitted(off: Floats, leads: Floats, slopes: Floats, known: Floats, begun: Floats) -> _Fit:
    """Least squares over points (n, 2) that are off, by derivatives (n, 2, 12) at errors that are taken to be, with
    what is known (12, 12) of them, and Tukey's weight."""
    whitening = np.linalg.cholesky(slopes + 1e-6 * np.eye(2)).transpose(0, 2, 1)  # along a line nothing is told
    leads = whitening @ leads
    target = (whitening @ off[..., None])[..., 0] + leads @ begun
    errors, weights = begun, np.ones(len(off))
    for _ in range(_ITERATIONS):
        left = target - leads @ errors
        squares = (left * left).sum(axis=1)
        usual = max(float(np.median(squares)), 1e-9)
        weights = np.maximum(1.0 - squares / (const.SPREADS**2 * usual), 0.0) ** 2
        weighed = leads * (weights * (_MEDIAN / (usual * const.OFFSET_FRAMES)))[:, None, None]
        weighed = weighed.reshape(-1, 12).T
        information, right = weighed @ leads.reshape(-1, 12), weighed @ target.reshape(-1)
        errors = np.linalg.solve(information + known, right)
    return _Fit(errors, information, right, int((weights > 0.0).sum()))


def _homographies(camera: Floats, older: Floats, errors: Floats, intrinsics: Array) -> Floats:
    """(k, 3, 3) pixels of the newest image from those of the older one, of points of the plane z = 0, if the cameras'
    errors (k, 12) are as large."""
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    lens = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    views = ((camera, errors[:, :6]), (older, errors[:, 6:]))
    newest, before = (lens @ (exp_many(error) @ invert(view))[:, :3, [0, 1, 3]] for view, error in views)
    return np.asarray(newest @ np.linalg.inv(before))


def _derivatives(camera: Floats, older: Floats, at: Floats, intrinsics: Array, points: Array) -> Floats:
    """(n, 2, 12) by how much points are found elsewhere in the older view, a unit of each error."""
    there = _homographies(camera, older, at + _STEPS, intrinsics)
    back = np.linalg.inv(_homographies(camera, older, at[None], intrinsics)[0])
    ends = _carried(points, back @ there)
    return np.asarray((ends[:12] - ends[12:]).transpose(1, 2, 0) / (2.0 * _STEP))


def _carried(points: Array, by: Floats) -> Floats:
    """(..., n, 2) points (n, 2) where homographies (..., 3, 3) take them."""
    ends = np.column_stack((points, np.ones(len(points)))) @ np.swapaxes(by, -1, -2)
    return np.asarray(ends[..., :2] / ends[..., 2:])


def _shown(points: Array, by: Floats, covered: Gray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(n,) which points of the older image are in the newest one, where nothing is expected to stand."""
    ends = _carried(points, by)
    inside = np.all((ends >= _HALF) & (ends < np.array(shape[::-1]) - _HALF), axis=1)
    cells = np.clip(ends / _CELL, 0, np.array(covered.shape[::-1]) - 1).astype(np.int64)
    return np.asarray(inside & (covered[cells[:, 1], cells[:, 0]] == 0))


def _structure(patches: NDArray[np.uint8]) -> Floats:
    """(n, 2, 2) sums of the products of slopes about the middles of patches, grey levels² a pixel²."""
    middle = patches[:, _HALF - _REACH - 1 : _HALF + _REACH + 2, _HALF - _REACH - 1 : _HALF + _REACH + 2].astype(float)
    down, right = np.gradient(middle, axis=(1, 2))
    slopes = np.stack((right, down), axis=-1)[:, 1:-1, 1:-1].reshape(len(patches), -1, 2)
    return np.asarray(slopes.transpose(0, 2, 1) @ slopes)


def _pixels(points: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (n, s, s) of the pixels of patches."""
    away = np.arange(-_HALF, _HALF + 1)
    rows, columns = points[:, 1, None, None] + away[:, None], points[:, 0, None, None] + away
    return np.broadcast_arrays(rows, columns)
