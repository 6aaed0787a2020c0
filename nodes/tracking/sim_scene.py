"""Pictures of cubes on a table, by exact projection: no part of it is shared with the mental image of the nodes.

Every face of a cube is a plane, so the inverse of its depth and its own coordinates
times that are affine in the pixel: a face is drawn by three affine functions and a
depth test, at four samples a pixel. Light comes from one direction; what stands in its
way throws a shadow with a soft rim on the table and on other faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking.geometry import Array, Floats, invert, transform

cv2.setNumThreads(1)

SAMPLES = 2
"""Per pixel, along each axis."""

TABLE_M = (1.5, 1.3)
TABLE_PX_PER_M = 800
TABLE_RIM_PX = 6
FACE_PX = 96

LIGHT = np.array([-0.42, -0.38, 1.05]) / np.linalg.norm([-0.42, -0.38, 1.05])
"""From the scene towards the middle of the lamp, world frame."""

LAMP_RADIUS = 0.07
LAMP_POINTS = 9
"""The lamp is a disc, of this radius at distance 1, and shadows are the mean of those that points of it throw."""

AMBIENT = 0.36
DIFFUSE = 0.78

_SIDES = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]


class Cube(NamedTuple):
    """A cube to draw.

    Attributes:
        pose: world_from_object, 4x4, origin at the cube's centre.
        side_m: length of its edges.
        colour: RGB, 0 to 255.
    """

    pose: Floats
    side_m: float
    colour: tuple[int, int, int]


class Face(NamedTuple):
    """A side of a cube, seen from outside: corner + a * right + b * up, a and b from 0 to 1 (world frame, metres)."""

    corner: Floats
    right: Floats
    up: Floats

    @property
    def normal(self) -> Floats:
        """Unit vector that points outwards."""
        normal = np.cross(self.right, self.up)
        return normal / np.linalg.norm(normal)


def draw(cubes: Sequence[Cube], camera: Floats, intrinsics: Array, size: tuple[int, int]) -> Array:
    """The picture without blur or noise.

    Args:
        cubes: above the plane z = 0, and in front of the camera.
        camera: world_from_camera, 4x4, above that plane.
        intrinsics: fx, fy, cx, cy in pixels.
        size: width and height in pixels.

    Returns:
        RGB, float32 (h, w, 3), 0 to 255.
    """
    image = _draw_table(cubes, camera, intrinsics, size)
    _draw_cubes(image, cubes, camera, intrinsics)
    return image


def develop(image: Array, blur_px: float, noise: float, rng: np.random.Generator) -> Array:
    """What a sensor makes of a picture.

    Args:
        image: float32 RGB.
        blur_px: standard deviation of the lens's blur, in pixels.
        noise: standard deviation of the sensor's noise, in grey levels of 256.
        rng: draws the noise.

    Returns:
        uint8 RGB.
    """
    if blur_px > 0.0:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    if noise > 0.0:
        image = image + np.float32(noise) * rng.standard_normal(image.shape, dtype=np.float32)
    developed: Array = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return developed


def cube_faces(cube: Cube) -> list[Face]:
    """All six sides."""
    faces = []
    for axis, sign in _SIDES:
        first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        right, up = (first, second) if sign > 0 else (second, first)
        corner = (sign * np.eye(3)[axis] - right - up) * cube.side_m / 2
        rotation = cube.pose[:3, :3]
        faces.append(Face(transform(cube.pose, corner), rotation @ right * cube.side_m, rotation @ up * cube.side_m))
    return faces


def cube_corners(side_m: float) -> Floats:
    """The corners of a cube in its own frame, (8, 3)."""
    return np.array(list(product((-1.0, 1.0), repeat=3))) * side_m / 2


def shadows(corners: Floats, face: Face) -> list[Floats]:
    """Where a cube keeps the lamp's light from a face's plane.

    Args:
        corners: of the cube, (8, 3), world frame, in the order of `cube_corners`.
        face: whose plane it falls on.

    Returns:
        For each point of the lamp a convex polygon (n, 2) in the face's coordinates a and
        b; none where nothing of the cube is between the plane and the light, or where the
        face is out of the shadow.
    """
    normal = face.normal
    heights = (corners - face.corner) @ normal
    if float((_lamp() @ normal).min()) <= 1e-3 or heights.max() <= 1e-4:
        return []
    points = [corners[heights >= 0]]
    for first, second in _EDGES:
        if (heights[first] < 0) != (heights[second] < 0):
            part = heights[first] / (heights[first] - heights[second])
            points.append((corners[first] + part * (corners[second] - corners[first]))[None])
    above = np.concatenate(points) - face.corner
    plane = np.stack((face.right / (face.right @ face.right), face.up / (face.up @ face.up)), axis=1)
    lifts = above @ normal
    fallen = [(above - np.outer(lifts / (light @ normal), light)) @ plane for light in _lamp()]
    everywhere = np.concatenate(fallen)
    if (everywhere.max(axis=0) < 0).any() or (everywhere.min(axis=0) > 1).any():
        return []
    return [cv2.convexHull(polygon.astype(np.float32))[:, 0].astype(np.float64) for polygon in fallen]


_EDGES = [(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)]


def _draw_table(cubes: Sequence[Cube], camera: Floats, intrinsics: Array, size: tuple[int, int]) -> Array:
    """The table with its shadows, over a wall that gets darker downwards."""
    width, height = TABLE_M
    table = Face(np.array([-width / 2, -height / 2, 0.0]), np.array([width, 0.0, 0.0]), np.array([0.0, height, 0.0]))
    wood = _wood()
    rows, columns = wood.shape[:2]
    light = _light_on(table, cubes, (columns, rows))
    texture = (wood * light[..., None]).astype(np.uint8)
    homography = _homography(table, camera, intrinsics) @ np.diag([1.0 / columns, 1.0 / rows, 1.0])
    homography = homography @ np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    wall = np.linspace(92.0, 46.0, size[1], dtype=np.float32)[:, None, None] * np.array([0.96, 1.0, 1.06], np.float32)
    picture = np.ascontiguousarray(np.broadcast_to(wall, (size[1], size[0], 3))).astype(np.uint8)
    cv2.warpPerspective(
        texture, homography, size, dst=picture, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT
    )
    return picture.astype(np.float32)


def _draw_cubes(image: Array, cubes: Sequence[Cube], camera: Floats, intrinsics: Array) -> None:
    """Put the cubes into the picture: depth test at `SAMPLES` x `SAMPLES` per pixel, then their mean."""
    position, height, width = camera[:3, 3], image.shape[0], image.shape[1]
    faces = [
        (face, cube, index)
        for index, cube in enumerate(cubes)
        for face in cube_faces(cube)
        if face.normal @ (position - face.corner) > 0
    ]
    drawn = [(_homography(face, camera, intrinsics), face, cube, index) for face, cube, index in faces]
    boxes = [_box(homography, width, height) for homography, *_ in drawn]
    shown = [(item, box) for item, box in zip(drawn, boxes, strict=True) if box is not None]
    if not shown:
        return
    left, top = (min(box[i] for _, box in shown) for i in (0, 1))
    right, bottom = (max(box[i] for _, box in shown) for i in (2, 3))
    shape = ((bottom - top) * SAMPLES, (right - left) * SAMPLES)
    inverse_depth = np.zeros(shape, np.float32)
    layer = np.zeros((*shape, 4), np.float32)
    for (homography, face, cube, index), box in shown:
        others = [other for number, other in enumerate(cubes) if number != index]
        texture = _face_texture(face, cube, others)
        _draw_face(layer, inverse_depth, homography, texture, box, (left, top))
    mean = cv2.resize(layer, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
    part = image[top:bottom, left:right]
    part *= 1.0 - mean[..., 3:]
    part += mean[..., :3]


def _draw_face(
    layer: Array, inverse_depth: Array, homography: Floats, texture: Array, box: tuple[int, ...], origin: tuple[int, int]
) -> None:
    """Draw one face where it is nearer than what is drawn already."""
    left, top, right, bottom = box
    step = 1.0 / SAMPLES
    first = step / 2 - 0.5
    u = (left + first + step * np.arange((right - left) * SAMPLES)).astype(np.float32)
    v = (top + first + step * np.arange((bottom - top) * SAMPLES)).astype(np.float32)
    rows = np.linalg.inv(homography).astype(np.float32)
    a, b, nearness = ((row[0] * u)[None, :] + (row[1] * v + row[2])[:, None] for row in rows)
    window = np.s_[
        (top - origin[1]) * SAMPLES : (bottom - origin[1]) * SAMPLES,
        (left - origin[0]) * SAMPLES : (right - origin[0]) * SAMPLES,
    ]
    inside = (a >= 0) & (b >= 0) & (a <= nearness) & (b <= nearness) & (nearness > inverse_depth[window])
    if not inside.any():
        return
    scale = FACE_PX / np.where(inside, nearness, 1.0)
    colours = cv2.remap(texture, a * scale - 0.5, b * scale - 0.5, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    np.copyto(inverse_depth[window], nearness, where=inside)
    np.copyto(layer[window], colours, where=inside[..., None])


def _homography(face: Face, camera: Floats, intrinsics: Array) -> Floats:
    """From a face's coordinates (a, b, 1) to pixels (times the depth)."""
    fx, fy, cx, cy = intrinsics
    lens = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    from_world = invert(camera)
    rotation = from_world[:3, :3]
    columns = (rotation @ face.right, rotation @ face.up, transform(from_world, face.corner))
    return lens @ np.stack(columns, axis=1)


def _box(homography: Floats, width: int, height: int) -> tuple[int, int, int, int] | None:
    """The pixels (left, top, right, bottom) that a face may touch; None where it is out of the picture."""
    corners = homography @ np.array([[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    if corners[2].min() < 1e-3:
        return None
    pixels = corners[:2] / corners[2]
    left, top = (int(x) for x in np.maximum(np.floor(pixels.min(axis=1)), 0))
    right, bottom = (int(x) for x in np.minimum(np.ceil(pixels.max(axis=1)) + 1, (width, height)))
    return (left, top, right, bottom) if left < right and top < bottom else None


def _light_on(face: Face, cubes: Sequence[Cube], size: tuple[int, int]) -> Array:
    """How bright a white face is at each of its points, float32 (h, w), shadows included."""
    slope = max(0.0, float(LIGHT @ face.normal))
    thrown = [shadows(transform(cube.pose, cube_corners(cube.side_m)), face) for cube in cubes]
    light = np.full((size[1], size[0]), AMBIENT + DIFFUSE * slope, np.float32)
    if not any(thrown):
        return light
    mask = np.empty((size[1], size[0]), np.uint8)
    for point in range(LAMP_POINTS):
        mask[:] = 0
        for polygons in thrown:
            if polygons:
                pixels = np.clip(polygons[point] * size - 0.5, -4096, 4096) * 16
                cv2.fillConvexPoly(mask, np.rint(pixels).astype(np.int32), 255, cv2.LINE_AA, 4)
        cv2.scaleAdd(mask.astype(np.float32), -DIFFUSE * slope / 255.0 / LAMP_POINTS, light, dst=light)
    return light


@lru_cache(maxsize=1)
def _lamp() -> Floats:
    """Directions (n, 3) to points of the lamp, evenly spread over its disc."""
    across = np.cross(LIGHT, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    down = np.cross(LIGHT, across)
    index = np.arange(LAMP_POINTS)
    radius = LAMP_RADIUS * np.sqrt((index + 0.5) / LAMP_POINTS)
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    return LIGHT + np.outer(radius * np.cos(turn), across) + np.outer(radius * np.sin(turn), down)


def _face_texture(face: Face, cube: Cube, others: Sequence[Cube]) -> Array:
    """Colour and full cover of each point of a face, float32 (FACE_PX, FACE_PX, 4)."""
    light = _light_on(face, others, (FACE_PX, FACE_PX))
    texture = np.full((FACE_PX, FACE_PX, 4), 255.0, np.float32)
    colour = np.array(cube.colour, np.float32)
    texture[..., :3] = np.minimum(colour * (light * _grain())[..., None], 255.0)
    texture[..., 3] = 1.0
    return texture


@lru_cache(maxsize=1)
def _grain() -> Array:
    """Faint unevenness of painted wood, about 1."""
    noise = np.random.default_rng(11).standard_normal((FACE_PX, FACE_PX)).astype(np.float32)
    streaks = cv2.GaussianBlur(noise, (0, 0), sigmaX=9.0, sigmaY=0.8)
    return np.asarray(1.0 + 0.02 * streaks / streaks.std(), dtype=np.float32)


@lru_cache(maxsize=1)
def _wood() -> Array:
    """The table's top of planks, RGB float32, with a dark rim."""
    columns, rows = (round(length * TABLE_PX_PER_M) for length in TABLE_M)
    rng = np.random.default_rng(7)
    noise = rng.standard_normal((rows, columns)).astype(np.float32)
    fine = cv2.GaussianBlur(noise, (0, 0), sigmaX=40.0, sigmaY=1.2)
    broad = cv2.GaussianBlur(noise, (0, 0), sigmaX=120.0, sigmaY=9.0)
    tone = 1.0 + 0.035 * fine / fine.std() + 0.05 * broad / broad.std()
    plank_px = rows // 8
    for index in range(0, rows, plank_px):
        tone[index : index + plank_px] *= rng.uniform(0.93, 1.06)
        tone[index : index + 2] *= 0.72
    wood = np.clip(tone[..., None] * np.array([168.0, 134.0, 98.0], np.float32), 0, 220).astype(np.float32)
    for edge in (wood[:TABLE_RIM_PX], wood[-TABLE_RIM_PX:], wood[:, :TABLE_RIM_PX], wood[:, -TABLE_RIM_PX:]):
        edge *= 0.55
    return wood
