"""What a model looks like: its edges as a camera sees them, and a small picture of it with corners marked.

And which of its corners a user can tell in a picture, and the pose by where they are in it."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.sources.shots import lens_matrix
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.math.geometry import (
    NEAREST_M,
    Array,
    Floats,
    invert,
    looking_down,
    make_pose,
    project,
    transform,
    unit,
)
from hierax.nodes.tracking.model.shapes import Shape
from hierax.nodes.tracking.simworld.raster import drawn_mesh

View = tuple[float, float]  # from where it is seen: turn and tilt, degrees
Marked = tuple[int, Floats]  # a corner's number, and where it is

SIZE = (340, 340)
_INTRINSICS = np.array([620.0, 620.0, 169.5, 169.5])
_AWAY = 2.5  # how many of its diameters the camera is away
_VIEWS: tuple[View, ...] = tuple((turn, tilt) for tilt in (28.0, -28.0) for turn in (-55.0, 35.0, 125.0, 215.0))
_NEARER = 1.02  # what is nearer than a corner by more hides it
_GROUND, _DARK, _BRIGHT = 246, 110.0, 225.0
_EDGE, _GIVEN, _ASKED = (60, 60, 60), (0, 110, 220), (220, 30, 30)
_DASH_PX = 2.5

LEAST = 4  # corners by which a pose is told
_MOST = 16  # corners that are asked for
_TURN = 0.9  # cosine of the angle up to which two edges that meet turn into one another
_MOST_OFF_PX, _MOST_OFF = 4.0, 0.03  # largest error of a pose: pixels, or share of how far apart the clicks are


class ModelView:
    """Pictures of a model; its first view shows the first corner."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape

    @cached_property
    def _renderer(self) -> LayerRenderer:
        return LayerRenderer(self.shape)

    def edges(self, pose: Floats, intrinsics: Array, size: tuple[int, int]) -> Floats:
        """(n, 4) dashes, x0, y0, x1, y1 in pixels, along the edges that a camera sees of it, camera_from_object."""
        layer = self._renderer.layer(pose, intrinsics, size)
        controls = controls_of(self.shape, pose, intrinsics, size, layer)
        seen = transform(pose, controls.points)
        half = _DASH_PX * seen[:, 2:] / intrinsics[0] * (controls.tangents @ pose[:3, :3].T)
        ends = [seen - half, seen + half]
        ahead = np.minimum(ends[0][:, 2], ends[1][:, 2]) > NEAREST_M
        return np.concatenate([project(end[ahead], intrinsics) for end in ends], axis=1)

    def showing(self, corner: Floats, view: View | None) -> View:
        """A view in which a corner is seen: the given one, where it is, else another one where there is."""
        tried = [*([view] if view is not None else []), *_VIEWS]
        return next((each for each in tried if self._shows(corner, each)), tried[0])

    def picture(self, view: View, given: Sequence[Marked], asked: Marked | None) -> Array:
        """RGB, with the corners that were clicked, and the one that is asked for."""
        camera = self._camera(view)
        picture = np.full((SIZE[1], SIZE[0], 3), _GROUND, dtype=np.uint8)
        nearness, facing = self._drawn(view)
        light = _DARK + (_BRIGHT - _DARK) * (facing @ camera[:3, :3] @ np.array([-0.45, -0.65, -0.61])).clip(0.0, 1.0)
        picture[nearness > 0.0] = light[nearness > 0.0, None].astype(np.uint8)
        dashes = np.rint(self.edges(invert(camera), _INTRINSICS, SIZE)).astype(np.int32).reshape(-1, 2, 2)
        cv2.polylines(picture, list(dashes), False, _EDGE, 1, cv2.LINE_AA)
        for (number, corner), colour in [*((each, _GIVEN) for each in given), *([(asked, _ASKED)] if asked else [])]:
            at = np.rint(project(transform(invert(camera), corner), _INTRINSICS)).astype(int).tolist()
            cv2.circle(picture, at, 9 if colour == _ASKED else 5, colour, 2, cv2.LINE_AA)
            beside = (at[0] + 11, at[1] - 7)
            cv2.putText(picture, str(number), beside, cv2.FONT_HERSHEY_SIMPLEX, 0.55, colour, 2, cv2.LINE_AA)
        return picture

    def _camera(self, view: View) -> Floats:
        """world_from_camera, the object's frame being the world's."""
        low, high = self.shape.low, self.shape.high
        away = _AWAY * float(np.linalg.norm(high - low))
        turn, tilt = np.radians(view)
        return looking_down(turn, tilt, away, 0.5 * (low + high))

    def _drawn(self, view: View) -> tuple[Array, Array]:
        """Nearness (h, w), 1/m, 0 where it is not, and normals (h, w, 3)."""
        corners = self.shape.vertices[self.shape.faces]
        normals = np.repeat(self.shape.normals[:, None], 3, axis=1)
        drawn = drawn_mesh((corners, normals), self._camera(view), _INTRINSICS, SIZE, 1)
        nearness, facing = np.zeros(SIZE[::-1]), np.zeros((*SIZE[::-1], 3))
        if drawn is not None:
            left, top, right, bottom = drawn.window
            nearness[top:bottom, left:right], facing[top:bottom, left:right] = drawn.nearness, drawn.at
        return nearness, facing

    def _shows(self, corner: Floats, view: View) -> bool:
        seen = transform(invert(self._camera(view)), corner)
        x, y = np.rint(project(seen, _INTRINSICS)).astype(int)
        around = self._drawn(view)[0][max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        return bool((around * seen[2] < _NEARER).all())


class Fit(NamedTuple):
    """A pose by corners."""

    pose: Floats  # camera_from_object
    off_px: float  # root of the mean square of how far the corners are from where they were clicked
    worst: int  # which one is farthest
    fits: bool  # whether that may come from clicking


def corners_of(shape: Shape) -> Floats:
    """(n, 3) corners, at most 16, the first of which span most: where three edges meet, or two at an angle."""
    ends = np.concatenate((shape.edges, shape.edges[:, ::-1]))
    found = []
    for vertex in np.unique(ends[:, 0]):
        along = unit(shape.vertices[ends[ends[:, 0] == vertex, 1]] - shape.vertices[vertex])
        if len(along) > 2 or (len(along) == 2 and along[0] @ along[1] > -_TURN):
            found.append(shape.vertices[vertex])
    corners = np.reshape(found, (-1, 3))
    scale = float(np.ptp(shape.vertices, axis=0).max())
    middle = corners.mean(axis=0) if len(corners) else 0.0
    rows = np.column_stack(((corners - middle) / scale, np.ones(len(corners))))
    spanned, chosen = 1e-3 * np.eye(4), list[int]()
    while len(chosen) < min(_MOST, len(corners)):
        # what the determinant of the corners' moments grows by
        gains = np.einsum("ni,ij,nj->n", rows, np.linalg.inv(spanned), rows)
        gains[chosen] = -1.0
        chosen.append(int(gains.argmax()))
        spanned += np.outer(rows[chosen[-1]], rows[chosen[-1]])
    return corners[chosen]


def fitted(corners: Floats, pixels: Floats, intrinsics: Array) -> Fit | None:
    """The pose that puts corners (n, 3), object's frame, at least `LEAST`, nearest to the pixels (n, 2) where they were
    clicked; None where there is none before the camera."""
    lens, best = lens_matrix(intrinsics), None
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(corners, pixels, lens, None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # they are on a line, say
        return None
    for turn, shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(corners, pixels, lens, None, turn, shift)
        pose = make_pose(cv2.Rodrigues(turn)[0], shift.ravel())
        fit = judged(pose, corners, pixels, intrinsics)
        if fit is not None and (best is None or fit.off_px < best.off_px):
            best = fit
    return best


def judged(pose: Floats, corners: Floats, pixels: Floats, intrinsics: Array) -> Fit | None:
    """How a pose fits corners as they were clicked; None where it has one behind the camera."""
    seen = transform(pose, corners)
    if not np.isfinite(seen).all() or seen[:, 2].min() < NEAREST_M:
        return None
    away = np.linalg.norm(project(seen, intrinsics) - pixels, axis=1)
    off_px = float(np.sqrt((away**2).mean()))
    apart = float(np.linalg.norm(np.ptp(pixels, axis=0)))
    return Fit(pose, off_px, int(away.argmax()), off_px < max(_MOST_OFF_PX, _MOST_OFF * apart))
