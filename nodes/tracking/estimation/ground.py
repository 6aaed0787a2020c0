"""What the table's texture says of the camera: an older image of it, beside the newest one.

Points of a plane are where a homography takes them from one image to another, and that follows from where the camera
was over the plane in both. So an image tells how the camera has moved since an older one, and, as soon as it has moved,
how it is tilted towards the table: what objects' edges tell but roughly, as each object may be tilted a little, too.
How high the camera is the texture does not say. The older camera's error is part of what is estimated (stochastic
cloning: Roumeliotis and Burdick, 2002), as what both images have in common tells of both.

The newest image is taken back to the older view, and patches of both compared there. What moves otherwise, as what
stands on the table, Tukey's weight leaves out."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.fusion import Known, Rows
from hierax.nodes.tracking.estimation.profiles import Singles
from hierax.nodes.tracking.math.batched import exp_many, inverse, only
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_se3, invert, rays
from hierax.nodes.tracking.model.controls import Indices
from hierax.nodes.tracking.schema import Ground, Imagery, Texture

Gray = NDArray[np.uint8]


class View(NamedTuple):
    """An image, and where it is expected to be seen from."""

    image: Array  # (h, w) or (h, w, 3), grey levels
    camera: Floats  # world_from_camera, where z = 0 is the table
    intrinsics: Array  # (4,) fx, fy, cx, cy in pixels

    @property
    def gray(self) -> Gray:
        """(h, w)."""
        if self.image.ndim == 2:
            return self.image
        return np.asarray(cv2.cvtColor(self.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


class Told(NamedTuple):
    """What is known when the texture was seen."""

    known: Known  # of the camera and all objects
    ground: Ground | None  # what is looked at in the next image; its camera's error has the rows `Known.older`


def told_by(view: View, texture: Texture, joint: Floats) -> Told:
    """What is known of the camera and all objects, by the texture, too; joint: what is known of them without it, as
    `Known` has it."""
    view = view._replace(image=view.gray)
    ground, said, known = texture["ground"], None, Known(joint)
    if texture["covered"].shape != _cells(view.gray) or view.camera[2, 3] <= 0.0:  # of another camera, or from below
        return Told(known, None)
    if ground is not None:
        older = slice(len(joint) - 6, len(joint))
        joint, rows = np.array(joint), np.r_[Rows.error, older]
        up = ground["camera"][2, :3]
        # How high the camera is, images say again and again, and err alike: older ones count less and less.
        joint[older, older][:3, :3] += const.RESTING_M**2 * np.outer(up, up)
        said = _said_by(view, ground, texture["covered"], joint[np.ix_(rows, rows)])
        known = Known(joint, older=older) if said is None else Known(*_with(said, joint, rows), older)
    if said is not None and ground is not None and said.found >= const.TEXTURE_KEPT * len(ground["points"]):
        return Told(known, ground)
    newer = ground_of(view, texture["covered"])
    return Told(known, ground) if newer is None else Told(known._replace(older=Rows.error), newer)


def corrected(ground: Ground, camera: Floats, newer: bool, error: Floats) -> Ground:
    """The same, with its camera as the image has it.

    Args: camera: the newest image's, as it turned out; newer: whether that is the texture's; error: the older one's."""
    return {**ground, "camera": camera if newer else ground["camera"] @ exp_se3(-error)}


def covered_by(imagery: Imagery) -> Gray:
    """(h / 8, w / 8) where bodies are expected, and next to them; 1 there."""
    width, height = imagery["size"]
    left, top = imagery["corner"]
    rows, columns = imagery["labels"].shape
    whole = np.zeros((height, width), dtype=np.uint8)
    whole[top : top + rows, left : left + columns] = imagery["labels"] > 0
    coarse = cv2.resize(whole * np.uint8(255), _cells(whole)[::-1], interpolation=cv2.INTER_AREA) > 0
    return np.asarray(cv2.dilate(coarse.astype(np.uint8), np.ones((5, 5), dtype=np.uint8)))


def ground_of(view: View, covered: Gray) -> Ground | None:
    """Corners of the table's texture, where nothing is expected to stand. None: there are too few."""
    height, width = view.gray.shape
    cells = np.stack(np.meshgrid(*(np.arange(count) for count in covered.shape[::-1])), axis=-1)
    towards = rays(const.COVER_PX * (cells + 0.5), view.intrinsics) @ view.camera[2, :3]
    free = (-towards * const.TEXTURE_FAR > 1.0) & (covered == 0)
    free = free.repeat(const.COVER_PX, axis=0).repeat(const.COVER_PX, axis=1)[:height, :width]
    inside = np.zeros_like(view.gray)
    middle = np.s_[const.PATCH_PX : -const.PATCH_PX, const.PATCH_PX : -const.PATCH_PX]
    inside[middle] = free[middle]
    most, weakest = const.TEXTURE_POINTS, const.TEXTURE_CORNER
    found = cv2.goodFeaturesToTrack(
        view.gray, most, weakest, const.PATCH_PX, mask=inside, blockSize=const.PATCH_PX // 3
    )
    if found is None or len(found) < const.LEAST_SHOWN:
        return None
    points = np.rint(found[:, 0]).astype(np.int64)
    side = 2 * const.PATCH_PX + 1
    windows = np.lib.stride_tricks.sliding_window_view(view.gray, (side, side))
    patches = windows[points[:, 1] - const.PATCH_PX, points[:, 0] - const.PATCH_PX]
    return {"camera": view.camera, "points": points, "patches": patches}


class _Fit(NamedTuple):
    """Errors that put points where they are found, and what is known of them: a quadratic around no error."""

    errors: Floats  # (12,) of the camera in this image and in the older one, twists in their frames
    information: Floats  # (12, 12)
    right: Floats  # (12,) the information, times the errors of which it speaks
    found: int  # points


def _said_by(view: View, ground: Ground, covered: Gray, spread: Floats) -> _Fit | None:
    """What the texture says; spread: (12, 12) covariance of the errors. None: too little of it is found."""
    known, fit = inverse(spread), _Fit(np.zeros(12), np.zeros((12, 12)), np.zeros(12), 0)
    least = const.LEAST_SHOWN
    for blur in const.TEXTURE_BLURS_PX:
        older, leads, moved_px = _older(ground["patches"], blur), None, np.inf
        for _ in range(const.TEXTURE_STEPS):
            if moved_px < const.TEXTURE_SETTLED_PX:
                break
            back = _homographies(view, ground, fit.errors[None])[0]  # from the older image's pixels
            shown = np.nonzero(_shown(ground["points"], back, covered, view.gray.shape))[0]
            least = max(const.LEAST_SHOWN, const.TEXTURE_KEPT * len(shown))
            if len(shown) < least:
                return None
            if leads is None:  # they hardly change with the errors
                leads = _derivatives(view, ground, fit.errors, back, ground["points"])
            flow = _flow(only(older, shown), _newer(view.gray, back, ground["points"][shown], blur))
            own, before = leads[shown], fit.errors
            whitened = flow.whitening @ own
            fit = _fitted(flow.target + whitened @ before, whitened, known, before)
            moved_px = float(np.median(np.linalg.norm(own @ (fit.errors - before), axis=1)))
    if moved_px >= const.TEXTURE_SETTLED_PX or min(fit.found, int(flow.alike.sum())) < least:
        return None
    return fit


class _Older(NamedTuple):
    """Patches of an older image, smoothed."""

    windows: Singles  # (n, s, s) what is about their middles, beside its mean
    slopes: Singles  # (n, 2, p) grey levels a pixel, of those that have neighbours
    products: Floats  # (n, 2, 2) of the slopes
    contrast: Singles  # (n,) variance


def _older(patches: Gray, blur: float) -> _Older:
    unused = const.PATCH_PX - const.WINDOW_PX - _reach(blur)
    near = slice(unused, patches.shape[1] - unused)
    windows = _apart(_smooth(patches[:, near, near], blur))
    right, down = windows[:, 1:-1, 2:] - windows[:, 1:-1, :-2], windows[:, 2:, 1:-1] - windows[:, :-2, 1:-1]
    slopes = np.float32(0.5) * np.stack((right, down), axis=1).reshape(len(windows), 2, -1)
    products = (slopes @ slopes.transpose(0, 2, 1)).astype(np.float64)
    return _Older(windows, slopes, products, (windows * windows).mean(axis=(1, 2)))


def _newer(gray: Gray, back: Floats, points: NDArray[np.int64], blur: float) -> Singles:
    """(n, s, s) what is about points of the older view in an image, which is taken back to that view first, smoothed,
    beside its mean."""
    reach = const.WINDOW_PX + _reach(blur)
    corners = np.tile(np.eye(3), (len(points), 1, 1))
    corners[:, :2, 2] = points - reach
    size, flags = (2 * reach + 1, 2 * reach + 1), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = np.stack([cv2.warpPerspective(gray, each, size, flags=flags) for each in back @ corners])
    return _apart(_smooth(seen.astype(np.uint8, copy=False), blur))


class _Flow(NamedTuple):
    """How far patches are beside where they should be, told across their slopes alone: along an edge nothing is."""

    whitening: Floats  # (n, 2, 2) grey levels a pixel
    target: Floats  # (n, 2) `whitening` @ pixels, each with the noise of one pixel's grey level
    alike: NDArray[np.bool_]  # (n,) whether it is the same texture


def _flow(older: _Older, newer: Singles) -> _Flow:
    """From patches (n, s, s) of two images (Lucas and Kanade, 1981; one step)."""
    whole = float(np.vdot(older.windows, older.windows))
    brighter = np.float32(np.vdot(older.windows, newer) / max(whole, 1e-9))
    left = (newer - brighter * older.windows)[:, 1:-1, 1:-1].reshape(len(newer), -1)
    products = float(brighter) ** 2 * older.products
    traces = np.trace(products, axis1=1, axis2=2)[:, None, None]
    lower = np.linalg.cholesky(products + (const.EDGE_EASE * traces + const.EDGE_EASE) * np.eye(2))
    target = -np.linalg.solve(lower, (brighter * (older.slopes @ left[..., None])).astype(np.float64))[..., 0]
    alike = (left * left).mean(axis=1) < (const.TEXTURE_OTHER * brighter) ** 2 * older.contrast
    return _Flow(lower.transpose(0, 2, 1), target, alike)


def _reach(blur: float) -> int:
    """How many pixels about one are smoothed to it."""
    return min(int(np.ceil(4.0 * blur)), const.PATCH_PX - const.WINDOW_PX)


def _smooth(patches: Gray, blur: float) -> Singles:
    """(n, s, s) what is about the middles of patches, which are larger by what is smoothed to it."""
    reach, rows = _reach(blur), patches.astype(np.float32)
    side = 2 * reach + 1
    smooth = cv2.GaussianBlur(rows.reshape(-1, rows.shape[2]), (side, side), blur).reshape(rows.shape)
    return np.ascontiguousarray(smooth[:, reach:-reach, reach:-reach])


def _apart(windows: Singles) -> Singles:
    """(n, s, s) the same beside the mean of each."""
    return np.asarray(windows - windows.mean(axis=(1, 2), keepdims=True))


def _fitted(target: Floats, leads: Floats, known: Floats, begun: Floats) -> _Fit:
    """Least squares over patches' targets (n, 2), by derivatives (n, 2, 12), with what is known (12, 12) of the errors,
    and Tukey's weight; begun: errors (12,) that are taken to be."""
    fit, rows, wanted = _Fit(begun, known, np.zeros(12), 0), leads.reshape(-1, 12), target.reshape(-1)
    for _ in range(const.TEXTURE_ITERATIONS):
        left = wanted - rows @ fit.errors
        squares = (left * left).reshape(-1, 2).sum(axis=1)
        usual = max(float(np.median(squares)), 1e-9)
        weights = np.maximum(1.0 - squares / (const.SPREADS**2 * usual), 0.0) ** 2
        # The older image's noise is the same in all that comes after.
        weighed = (rows * (weights * (const.TWO_MEDIAN / (usual * const.OFFSET_FRAMES))).repeat(2)[:, None]).T
        information, right = weighed @ rows, weighed @ wanted
        fit = _Fit(np.linalg.solve(information + known, right), information, right, int((weights > 0.0).sum()))
    return fit


def _with(said: _Fit, joint: Floats, rows: Indices) -> tuple[Floats, Floats]:
    """The covariance, and what is expected, with that (a Kalman filter's update, of what is told as information)."""
    spread = joint[np.ix_(rows, rows)]
    gain = joint[:, rows] @ said.information @ np.linalg.inv(np.eye(12) + spread @ said.information)
    after = joint - gain @ joint[rows]
    after = 0.5 * (after + after.T)
    return after, after[:, rows] @ said.right


def _homographies(view: View, ground: Ground, errors: Floats) -> Floats:
    """(k, 3, 3) pixels of the newest image from those of the older one, of points of the plane z = 0, if the cameras'
    errors (k, 12) are as large."""
    fx, fy, cx, cy = (float(part) for part in view.intrinsics)
    lens = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    cameras = ((view.camera, errors[:, :6]), (ground["camera"], errors[:, 6:]))
    newest, older = (lens @ (exp_many(error) @ invert(camera))[:, :3, [0, 1, 3]] for camera, error in cameras)
    return np.asarray(newest @ np.linalg.inv(older))


def _derivatives(view: View, ground: Ground, at: Floats, there: Floats, points: NDArray[np.int64]) -> Floats:
    """(n, 2, 12) by how much points are found elsewhere in the older image, a unit of each error; there: (3, 3) where
    they are in the newest one with the errors (12,) that are supposed."""
    back = np.linalg.inv(there)
    steps = const.ERROR_STEP * np.concatenate((np.eye(12), -np.eye(12)))
    ends = _carried(points, back @ _homographies(view, ground, at + steps))
    return np.asarray((ends[:12] - ends[12:]).transpose(1, 2, 0) / (2.0 * const.ERROR_STEP))


def _carried(points: Array, by: Floats) -> Floats:
    """(..., n, 2) points (n, 2) where homographies (..., 3, 3) take them."""
    ends = np.column_stack((points, np.ones(len(points)))) @ np.swapaxes(by, -1, -2)
    return np.asarray(ends[..., :2] / ends[..., 2:])


def _shown(points: Array, by: Floats, covered: Gray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(n,) which points of the older image are in the newest one, where nothing is expected to stand."""
    ends = _carried(points, by)
    before = np.column_stack((points, np.ones(len(points)))) @ by[2] > 0.0
    inside = before & np.all((ends >= const.PATCH_PX) & (ends < np.array(shape[::-1]) - const.PATCH_PX), axis=1)
    cells = np.clip(ends / const.COVER_PX, 0, np.array(covered.shape[::-1]) - 1).astype(np.int64)
    return np.asarray(inside & (covered[cells[:, 1], cells[:, 0]] == 0))


def _cells(gray: Gray) -> tuple[int, int]:
    """Rows and columns of the cells of an image."""
    height, width = gray.shape
    return -(-height // const.COVER_PX), -(-width // const.COVER_PX)
