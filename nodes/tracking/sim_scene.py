"""Pictures of cubes on a table, by exact projection: no part of it is shared with the mental image of the nodes.

Every face of a cube is a plane, so the inverse of its depth and its own coordinates
times that are affine in the pixel: a face is drawn by three affine functions and a
depth test, at four samples a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from hierax.nodes.tracking.geometry import Array, Floats, invert, transform
from hierax.nodes.tracking.sim_light import Cube, Face, light_on

cv2.setNumThreads(1)

SAMPLES = 2
"""Per pixel, along each axis."""

TABLE_M = (1.5, 1.3)
TABLE_PX_PER_M = 800
TABLE_RIM_PX = 6
FACE_PX = 96

_SIDES = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]


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


def _draw_table(cubes: Sequence[Cube], camera: Floats, intrinsics: Array, size: tuple[int, int]) -> Array:
    """The table with its shadows, over a wall that gets darker downwards."""
    width, height = TABLE_M
    table = Face(np.array([-width / 2, -height / 2, 0.0]), np.array([width, 0.0, 0.0]), np.array([0.0, height, 0.0]))
    homography = _homography(table, camera, intrinsics)
    wood = _wood()
    texels = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    texels = np.diag([1.0 / wood.shape[1], 1.0 / wood.shape[0], 1.0]) @ texels
    picture = _wall(size)
    cv2.warpPerspective(wood, homography @ texels, size, picture, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    lit: Array = picture.astype(np.float32)
    lit *= light_on(table, cubes, size, homography)[..., None]
    return lit


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
    layer: Array,
    inverse_depth: Array,
    homography: Floats,
    texture: Array,
    box: tuple[int, ...],
    origin: tuple[int, int],
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


def _face_texture(face: Face, cube: Cube, others: Sequence[Cube]) -> Array:
    """Colour and full cover of each point of a face, float32 (FACE_PX, FACE_PX, 4)."""
    texels = np.array([[FACE_PX, 0.0, -0.5], [0.0, FACE_PX, -0.5], [0.0, 0.0, 1.0]])
    light = light_on(face, others, (FACE_PX, FACE_PX), texels)
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


def _wall(size: tuple[int, int]) -> Array:
    """What is behind the table, uint8 RGB, before the light is taken into account."""
    grey = np.linspace(86.0, 43.0, size[1], dtype=np.float32)[:, None, None] * np.array([0.96, 1.0, 1.06], np.float32)
    wall: Array = np.repeat(grey.astype(np.uint8), size[0], axis=1)
    return wall


@lru_cache(maxsize=1)
def _wood() -> Array:
    """The table's top of planks, RGB uint8, with a dark rim."""
    columns, rows = (round(length * TABLE_PX_PER_M) for length in TABLE_M)
    rng = np.random.default_rng(7)
    tone = 1.0 + 0.035 * _streaks(rng, (rows, columns), 4) + 0.05 * _streaks(rng, (rows, columns), 24)
    plank_px = rows // 8
    for index in range(0, rows, plank_px):
        tone[index : index + plank_px] *= rng.uniform(0.93, 1.06)
        tone[index : index + 2] *= 0.72
    wood = np.clip(tone[..., None] * np.array([168.0, 134.0, 98.0], np.float32), 0, 220).astype(np.uint8)
    for edge in (wood[:TABLE_RIM_PX], wood[-TABLE_RIM_PX:], wood[:, :TABLE_RIM_PX], wood[:, -TABLE_RIM_PX:]):
        edge[:] = (edge * 0.55).astype(np.uint8)
    return wood


def _streaks(rng: np.random.Generator, shape: tuple[int, int], width_px: int) -> Array:
    """Smooth unevenness of deviation 1 that runs along the rows, float32."""
    rows, columns = shape
    coarse = (rows // width_px + 2, columns // (width_px * 12) + 2)
    noise = rng.standard_normal(coarse).astype(np.float32)
    smooth: Array = cv2.resize(noise, (columns, rows), interpolation=cv2.INTER_CUBIC)
    even: Array = smooth / smooth.std()
    return even
