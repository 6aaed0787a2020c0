"""Segmented depth images of meshes at given poses, by pybullet's TinyRenderer.

The renderer holds a pybullet client of its own with nothing but the objects in it, all
moved into the camera's frame: no table, no light, no physics. The client is a cache; an
image depends on the arguments alone, to the bit.
"""

from __future__ import annotations

import atexit
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.bullet import load_pybullet
from hierax.nodes.tracking.geometry import Array, Floats, invert, project, quaternion_of, transform
from hierax.runtime import Elements, Value

_FACES_PER_SHAPE = 15_000
"""A pybullet visual shape refuses much larger meshes; larger ones are drawn in parts."""

_NEAREST_M = 0.01
_MARGIN_PX = 3


class Item(NamedTuple):
    """One object to draw.

    Attributes:
        label: 1 to 255, unique in the image.
        vertices: (n, 3) float64, metres, object's frame.
        faces: (m, 3) int, indices of vertices, counter-clockwise seen from outside.
        pose: camera_from_object.
    """

    label: int
    vertices: Floats
    faces: Array
    pose: Floats


class Window(NamedTuple):
    """A part of an image: columns left to right, rows top to bottom, the ends excluded."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.right - self.left, self.bottom - self.top


class DepthRenderer:
    """Draws labelled depth; keeps its client and the meshes in it from one image to the next."""

    def __init__(self) -> None:
        self._client: int | None = None
        self._meshes: list[tuple[int, Floats, Array]] = []
        self._bodies: list[list[int]] = []

    def render(self, items: Sequence[Item], intrinsics: Array, size: tuple[int, int]) -> tuple[Array, Array]:
        """Depth and labels of the items as a pinhole camera sees them.

        Args:
            items: what is drawn, in any order.
            intrinsics: (4,) fx, fy, cx, cy in pixels, pixel centres at integers.
            size: width and height in pixels.

        Returns:
            depth (h, w) float32, z in the camera's frame in metres, 0 where nothing is;
            labels (h, w) uint8, 0 where nothing is.

        Raises:
            ValueError: labels are doubled or out of range.
        """
        ordered = sorted(items, key=lambda item: item.label)
        labels = [item.label for item in ordered]
        if len(set(labels)) != len(labels) or not all(1 <= label <= 255 for label in labels):
            raise ValueError(f"labels must be different and from 1 to 255, got {labels}")
        width, height = size
        depth = np.zeros((height, width), dtype=np.float32)
        drawn = np.zeros((height, width), dtype=np.uint8)
        corners = [transform(item.pose, _corners(item.vertices)) for item in ordered]
        window = _window(corners, intrinsics, size)
        if window is None:
            return depth, drawn
        self._load(ordered)
        z_range = _z_range(corners)
        z_buffer, bodies = self._draw(ordered, intrinsics, window, z_range)
        near, far = z_range
        table = np.zeros(2 + sum(map(len, self._bodies)), dtype=np.uint8)
        for item, parts in zip(ordered, self._bodies, strict=True):
            table[np.asarray(parts) + 1] = item.label
        # Where nothing is, the renderer's label is -1; its depth there is the far plane.
        found = table[bodies + 1]
        metric = near * far / (far - (far - near) * z_buffer.astype(np.float64))
        view = np.s_[window.top : window.bottom, window.left : window.right]
        drawn[view] = found
        depth[view] = np.where(found > 0, metric, 0.0)
        return depth, drawn

    def close(self) -> None:
        """End the client; the next image starts a new one."""
        if self._client is None:
            return
        pybullet = load_pybullet()
        atexit.unregister(self.close)
        if pybullet.isConnected(self._client):
            pybullet.disconnect(self._client)
        self._client = None
        self._meshes = []
        self._bodies = []

    def _load(self, items: Sequence[Item]) -> None:
        """Have exactly these meshes in the client; a changed set starts a new client, so that no history is left."""
        if self._client is not None and self._holds(items):
            return
        self.close()
        pybullet = load_pybullet()
        self._client = pybullet.connect(pybullet.DIRECT)
        atexit.register(self.close)
        for item in items:
            self._bodies.append(_create_bodies(self._client, item))
            self._meshes.append((item.label, item.vertices, item.faces))

    def _holds(self, items: Sequence[Item]) -> bool:
        if len(items) != len(self._meshes):
            return False
        return all(
            item.label == label and _same(item.vertices, vertices) and _same(item.faces, faces)
            for item, (label, vertices, faces) in zip(items, self._meshes, strict=True)
        )

    def _draw(
        self, items: Sequence[Item], intrinsics: Array, window: Window, z_range: tuple[float, float]
    ) -> tuple[Array, Array]:
        pybullet = load_pybullet()
        for item, parts in zip(items, self._bodies, strict=True):
            position = item.pose[:3, 3].tolist()
            quaternion = quaternion_of(item.pose[:3, :3]).tolist()
            for body in parts:
                pybullet.resetBasePositionAndOrientation(body, position, quaternion, physicsClientId=self._client)
        width, height = window.size
        # OpenGL's camera looks along -z with y up; ours along z with y down.
        view = np.diag([1.0, -1.0, -1.0, 1.0])
        result = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=view.T.ravel().tolist(),
            projectionMatrix=_frustum(intrinsics, window, z_range).T.ravel().tolist(),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        z_buffer = np.asarray(result[3], dtype=np.float32).reshape(height, width)
        bodies = np.asarray(result[4], dtype=np.int32).reshape(height, width)
        return z_buffer, bodies


class SegmentedDepth:
    """ϱ of the spatial node: the scene that it expects, as a depth image and a label image (theory, example 3).

    An edge function with a renderer of its own, which is only a cache.
    """

    def __init__(self) -> None:
        self._renderer = DepthRenderer()

    def __call__(self, belief: Value) -> Elements:
        """One element, or none before the camera is known.

        Args:
            belief: of the spatial node: "camera" (world_from_camera or None), "intrinsics",
                "size", and "bodies" with "id", "obj_id", "pose" (world_from_object),
                "covariance", "status" and "model" {"vertices", "faces"}.

        Returns:
            {"depth": float32 (h, w), metres along the camera's z, 0 where nothing is;
            "labels": uint8 (h, w), ids, 0 where nothing is; "camera": world_from_camera at
            which it was drawn; "intrinsics"; "poses": tuple of {"id", "obj_id", "pose",
            "covariance", "status"}}.
        """
        camera = belief["camera"]
        if camera is None:
            return ()
        camera_from_world = invert(camera)
        items = [_item(body, camera_from_world) for body in belief["bodies"]]
        depth, labels = self._renderer.render(items, belief["intrinsics"], tuple(belief["size"]))
        kept = ("id", "obj_id", "pose", "covariance", "status")
        return (
            {
                "depth": depth,
                "labels": labels,
                "camera": camera,
                "intrinsics": belief["intrinsics"],
                "poses": tuple({key: body[key] for key in kept} for body in belief["bodies"]),
            },
        )


def _item(body: Mapping[str, Value], camera_from_world: Floats) -> Item:
    model = body["model"]
    return Item(body["id"], model["vertices"], model["faces"], camera_from_world @ body["pose"])


def _create_bodies(client: int, item: Item) -> list[int]:
    """The bodies that show one mesh; the numbers pybullet gives them count from 0 in a new client."""
    pybullet = load_pybullet()
    parts = []
    for start in range(0, len(item.faces), _FACES_PER_SHAPE):
        used, faces = np.unique(item.faces[start : start + _FACES_PER_SHAPE], return_inverse=True)
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=item.vertices[used].tolist(),
            indices=faces.ravel().tolist(),
            physicsClientId=client,
        )
        parts.append(int(pybullet.createMultiBody(0, -1, shape, physicsClientId=client)))
    return parts


def _same(first: Array, second: Array) -> bool:
    return first is second or np.array_equal(first, second)


def _corners(vertices: Floats) -> Floats:
    """The eight corners (8, 3) of the vertices' bounding box."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    choose = np.array([[(index >> axis) & 1 for axis in range(3)] for index in range(8)])
    corners: Floats = np.where(choose == 1, high, low)
    return corners


def _z_range(corners: Sequence[Floats]) -> tuple[float, float]:
    """Near and far plane, close around the objects: that is what a float32 depth buffer is precise with."""
    depths = np.concatenate([points[:, 2] for points in corners])
    near = max(0.95 * float(depths.min()), _NEAREST_M)
    return near, max(1.05 * float(depths.max()), 2.0 * near)


def _window(corners: Sequence[Floats], intrinsics: Array, size: tuple[int, int]) -> Window | None:
    """The part of the image that holds all objects; None where none can be seen."""
    width, height = size
    visible = [points for points in corners if points[:, 2].max() > _NEAREST_M]
    if not visible:
        return None
    if any(points[:, 2].min() <= _NEAREST_M for points in visible):
        return Window(0, 0, width, height)
    pixels = project(np.concatenate(visible), intrinsics)
    low = np.floor(pixels.min(axis=0)).astype(int) - _MARGIN_PX
    high = np.ceil(pixels.max(axis=0)).astype(int) + _MARGIN_PX + 1
    left, top = max(int(low[0]), 0), max(int(low[1]), 0)
    right, bottom = min(int(high[0]), width), min(int(high[1]), height)
    return Window(left, top, right, bottom) if left < right and top < bottom else None


def _frustum(intrinsics: Array, window: Window, z_range: tuple[float, float]) -> Floats:
    """OpenGL's projection of a window of an OpenCV pinhole camera.

    A pixel reaches half a pixel to each side of its centre. TinyRenderer samples half a
    pixel to the left of and above a pixel's centre in OpenGL's sense, hence the shift.
    """
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    near, far = z_range
    cx, cy = cx - 0.5, cy + 0.5
    left, right = (window.left - 0.5 - cx) / fx, (window.right - 0.5 - cx) / fx
    top, bottom = -(window.top - 0.5 - cy) / fy, -(window.bottom - 0.5 - cy) / fy
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 / (right - left)
    matrix[0, 2] = (right + left) / (right - left)
    matrix[1, 1] = 2.0 / (top - bottom)
    matrix[1, 2] = (top + bottom) / (top - bottom)
    matrix[2, 2] = -(far + near) / (far - near)
    matrix[2, 3] = -2.0 * far * near / (far - near)
    matrix[3, 2] = -1.0
    return matrix
