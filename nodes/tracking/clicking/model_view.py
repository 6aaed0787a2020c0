"""What a model looks like: its edges as a camera sees them, and a small picture of it with corners marked."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np

from hierax.nodes.tracking.imagery.controls import controls_of
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats, invert, looking_down, project, transform
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
