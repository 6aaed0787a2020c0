"""Each object drawn alone: its depth in a window of the image, as if nothing hid it.

A mesh of few triangles is drawn by exact ray casting. A ray r (z = 1) meets the triangle of corners a, b, c where r =
a·α + b·β + c·γ with α, β, γ not below 0, at the inverse depth 1/z = α + β + γ; all four are affine in the pixel. A
large mesh is drawn by pybullet's TinyRenderer, each by a client of its own with nothing else in it: no table, no light,
no physics. The client is a cache; a layer depends on the arguments alone, to the bit."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.imagery.physics import Bullet
from hierax.nodes.tracking.math.geometry import Array, Floats, Size, cross, project, quaternion_of, transform
from hierax.nodes.tracking.model.shapes import Shape

NEAREST_DRAWN_M = 0.01  # what is nearer to the camera is not drawn; farther than where it stops to be looked at

_FACES_PER_SHAPE = 15_000  # a pybullet visual shape refuses much larger meshes; larger ones are drawn in parts
_CAST_MAX = 300  # triangles up to which casting rays is quicker than TinyRenderer
_MARGIN_PX = 3
_BARELY = 1e-12  # a plane or a triangle that comes nearer to the camera's centre than this (m, m³) is seen edge-on
_STRIP_PX = 1 << 14  # rays that are cast together
_SEAM = 1e-9  # what α, β, γ may be below 0, 1/m: a ray between two triangles meets one of them


class Window(NamedTuple):
    """A part of an image: columns left to right, rows top to bottom, the ends excluded."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size(self) -> Size:
        """Width and height in pixels."""
        return self.right - self.left, self.bottom - self.top

    @property
    def corner(self) -> Floats:
        """The first pixel."""
        return np.array([self.left, self.top], dtype=np.float64)


class Layer(NamedTuple):
    """One object as a camera sees it, were it alone."""

    window: Window  # where its image stands in the camera's
    inverse: Floats  # (h, w) float64, 1/z of the surface, 1/m; 0 where it is not
    # (n, 3) of the far sides of its bounding box: 1/z at pixel (u, v) of the camera's image is a·u + b·v + c; a ray
    # leaves the box where the greatest of them is
    sides: Floats

    def leaving(self, pixels: Floats) -> Floats:
        """1/z (n,) at which the rays through pixels (n, 2) of the camera's image leave that box; 0 for never."""
        return np.asarray((pixels @ self.sides[:, :2].T + self.sides[:, 2]).max(axis=1, initial=0.0))


class MeshRenderer:
    """Draws the depth of one mesh; keeps its client, which begins with the first image."""

    def __init__(self, vertices: Floats, faces: Array) -> None:
        self._vertices, self._faces = vertices, faces
        self._bullet = Bullet()
        self._bodies: list[int] = []

    def inverse_depth(self, pose: Floats, intrinsics: Array, window: Window) -> Floats:
        """(h, w) float64, 1/z in 1/m, 0 where the mesh is not, in a part of the image, by camera_from_object and fx,
        fy, cx, cy in pixels, pixel centres at integers."""
        bullet = self._bullet
        if not self._bodies:
            self._create()
        position, quaternion = pose[:3, 3].tolist(), quaternion_of(pose[:3, :3]).tolist()
        for body in self._bodies:
            bullet.resetBasePositionAndOrientation(body, position, quaternion)
        # Near and far plane close around the object: that is what a float32 depth buffer is precise with.
        depths = transform(pose, _corners(self._vertices.min(axis=0), self._vertices.max(axis=0)))[:, 2]
        near = max(0.95 * float(depths.min()), NEAREST_DRAWN_M)
        far = max(1.05 * float(depths.max()), 2.0 * near)
        width, height = window.size
        # OpenGL's camera looks along -z with y up; ours along z with y down.
        view = np.diag([1.0, -1.0, -1.0, 1.0])
        lens = _frustum(intrinsics, window, (near, far))
        matrices = {"viewMatrix": view.T.ravel().tolist(), "projectionMatrix": lens.T.ravel().tolist()}
        result = bullet.getCameraImage(width, height, **matrices, shadow=0, renderer=bullet.ER_TINY_RENDERER)
        z_buffer = np.asarray(result[3], dtype=np.float32).reshape(height, width).astype(np.float64)
        seen = np.asarray(result[4], dtype=np.int32).reshape(height, width) >= 0
        return np.where(seen, (far - (far - near) * z_buffer) / (near * far), 0.0)

    def _create(self) -> None:
        bullet = self._bullet
        for start in range(0, len(self._faces), _FACES_PER_SHAPE):
            used, faces = np.unique(self._faces[start : start + _FACES_PER_SHAPE], return_inverse=True)
            mesh = {"vertices": self._vertices[used].tolist(), "indices": faces.ravel().tolist()}
            shape = bullet.createVisualShape(bullet.GEOM_MESH, **mesh)
            self._bodies.append(int(bullet.createMultiBody(0, -1, shape)))


class LayerRenderer:
    """Draws the layer of one shape, of `hierax.nodes.tracking.model.shapes.shape_of`."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self._triangles = shape.vertices[shape.faces]
        both_sides = np.concatenate((shape.faces, shape.faces[~shape.closed][:, ::-1]))  # of open sheets
        self._mesh = None if len(shape.faces) <= _CAST_MAX else MeshRenderer(shape.vertices, both_sides)

    def layer(self, pose: Floats, intrinsics: Array, size: Size) -> Layer | None:
        """The object alone, by camera_from_object, fx, fy, cx, cy in pixels, pixel centres at integers, and the image's
        width and height in pixels; None where no part of it can be in the image."""
        shape = self.shape
        window = window_of(transform(pose, _corners(shape.low, shape.high)), intrinsics, size)
        if window is None:
            return None
        if self._mesh is None:
            inverse = _cast(transform(pose, self._triangles), shape.closed, intrinsics, window)
        else:
            inverse = self._mesh.inverse_depth(pose, intrinsics, window)
        return Layer(window, inverse, _far_sides(shape, pose, intrinsics))


def window_of(corners: Floats, intrinsics: Array, size: Size) -> Window | None:
    """The part of the image that corners (n, 3), camera's frame, span; None where that is nothing."""
    width, height = size
    nearest, farthest = float(corners[:, 2].min()), float(corners[:, 2].max())
    if farthest <= NEAREST_DRAWN_M:
        return None
    if nearest <= NEAREST_DRAWN_M:
        return Window(0, 0, width, height)
    pixels = project(corners, intrinsics)
    low = np.floor(pixels.min(axis=0)).astype(int) - _MARGIN_PX
    high = np.ceil(pixels.max(axis=0)).astype(int) + _MARGIN_PX + 1
    left, top = max(int(low[0]), 0), max(int(low[1]), 0)
    right, bottom = min(int(high[0]), width), min(int(high[1]), height)
    return Window(left, top, right, bottom) if left < right and top < bottom else None


def surrounding(windows: Sequence[Window]) -> Window:
    """The window that holds all; an empty one of none."""
    if not windows:
        return Window(0, 0, 0, 0)
    lefts, tops, rights, bottoms = zip(*windows, strict=True)
    return Window(min(lefts), min(tops), max(rights), max(bottoms))


def _cast(corners: Floats, closed: Array, intrinsics: Array, window: Window) -> Floats:
    """Inverse depth (h, w) at which each pixel's ray first meets a triangle, 0 where it meets none; corners: (m, 3, 3)
    camera's frame, metres; closed: (m,) whether only one side is seen, from which they go counter-clockwise."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    sides = np.stack((cross(b, c), cross(c, a), cross(a, b)), axis=1)
    volume = np.sum(sides[:, 0] * a, axis=1)
    chosen = np.nonzero((volume < -_BARELY) | (~closed & (volume > _BARELY)))[0]
    shares = sides[chosen] / volume[chosen, None, None]
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    across, down = shares[..., 0] / fx, shares[..., 1] / fy
    level = shares[..., 2] + across * (window.left - cx) + down * (window.top - cy)
    boxes = _boxes(corners[chosen], intrinsics, window)
    width, height = window.size
    columns, rows = np.arange(float(width)), np.arange(float(height))
    firsts, lasts = _spans(across, down[..., None] * rows + level[..., None])
    across, down, level = (part.sum(axis=1) for part in (across, down, level))
    inverse = np.zeros((height, width))
    for at, left, top, right, bottom in _strips(boxes):
        some, part = columns[left:right], inverse[top:bottom, left:right]
        met = (down[at] * rows[top:bottom] + level[at])[:, None] + across[at] * some
        inside = met > part
        inside &= some >= firsts[at, top:bottom, None]
        inside &= some <= lasts[at, top:bottom, None]
        np.copyto(part, met, where=inside)
    inverse[inverse >= 1.0 / NEAREST_DRAWN_M] = 0.0
    return inverse


def _spans(across: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Between which columns (n, h) rays meet triangles, row by row: where none of α, β, γ is below 0, which are start
    (n, 3, h) at column 0, and by `across` (n, 3) more in each next one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = -(start + _SEAM) / across[..., None]
    rises, falls = across[..., None] > 0.0, across[..., None] < 0.0
    outside = ~(rises | falls) & (start < -_SEAM)
    firsts = np.where(rises, ends, np.where(outside, np.inf, -np.inf)).max(axis=1)
    return firsts, np.where(falls, ends, np.inf).min(axis=1)


def _strips(boxes: NDArray[np.intp]) -> Iterator[tuple[int, int, int, int, int]]:
    """Boxes (n, 4) in strips of few pixels each, whose numbers stay in the processor's cache: which box, left, top,
    right, bottom."""
    for at, (left, top, right, bottom) in enumerate(boxes.tolist()):
        step = max(1, _STRIP_PX // max(right - left, 1))
        for first in range(top, bottom, step):
            yield at, left, first, right, min(first + step, bottom)


def _boxes(corners: Floats, intrinsics: Array, window: Window) -> NDArray[np.intp]:
    """Of triangles (n, 3, 3): left, top, right, bottom (n, 4) in the window of the pixels that they can touch."""
    whole = np.array([0, 0, *window.size], dtype=np.intp)
    boxes = np.tile(whole, (len(corners), 1))
    ahead = corners[..., 2].min(axis=1, initial=np.inf) > NEAREST_DRAWN_M
    pixels = project(corners[ahead], intrinsics) - window.corner
    boxes[ahead, :2] = np.floor(pixels.min(axis=1))
    boxes[ahead, 2:] = np.ceil(pixels.max(axis=1)) + 1.0
    return np.clip(boxes, 0, whole[[2, 3, 2, 3]])


def _far_sides(shape: Shape, pose: Floats, intrinsics: Array) -> Floats:
    """What the sides of the bounding box that a ray can leave it through look like, as `Layer.sides`."""
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    normals = np.concatenate((np.eye(3), -np.eye(3))) @ pose[:3, :3].T
    offsets = np.concatenate((shape.high, -shape.low)) + normals @ pose[:3, 3]
    normals, offsets = normals[offsets > _BARELY], offsets[offsets > _BARELY]
    across, down = normals[:, 0] / (fx * offsets), normals[:, 1] / (fy * offsets)
    return np.stack((across, down, normals[:, 2] / offsets - across * cx - down * cy), axis=1)


def _corners(low: Floats, high: Floats) -> Floats:
    """The eight corners (8, 3) of a bounding box."""
    choose = np.array([[(index >> axis) & 1 for axis in range(3)] for index in range(8)])
    return np.asarray(np.where(choose == 1, high, low))


def _frustum(intrinsics: Array, window: Window, z_range: tuple[float, float]) -> Floats:
    """OpenGL's projection of a window of an OpenCV pinhole camera. A pixel reaches half a pixel to each side of its
    centre; TinyRenderer samples half a pixel to the left of and above that in OpenGL's sense, hence the shift."""
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    near, far = z_range
    cx, cy = cx - 0.5, cy + 0.5
    left, right = (window.left - 0.5 - cx) / fx, (window.right - 0.5 - cx) / fx
    top, bottom = -(window.top - 0.5 - cy) / fy, -(window.bottom - 0.5 - cy) / fy
    width, height, depth = right - left, top - bottom, far - near
    return np.array(
        [
            [2.0 / width, 0.0, (right + left) / width, 0.0],
            [0.0, 2.0 / height, (top + bottom) / height, 0.0],
            [0.0, 0.0, -(far + near) / depth, -2.0 * far * near / depth],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
