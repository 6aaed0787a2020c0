"""Rigid poses and the pinhole camera.

A pose ``a_from_b`` is a 4 × 4 float64 matrix that takes homogeneous coordinates in frame b to coordinates in frame a. A
twist is (translation, rotation): metres, then radians. An uncertainty of a pose is the 6 × 6 covariance of the twist ξ
in ``pose @ exp_se3(ξ)``: it stands in the *object's* frame, so it is the same for a pose in the camera's frame and in
the world's. Cameras are OpenCV's: x right, y down, z forward, pixel centres at integers."""

from math import atan2, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Array = NDArray[Any]
Size = tuple[int, int]  # width and height in pixels

NEAREST_M = 0.02
"""What is nearer to a camera than this, along its z, is not looked at: its pixels would be anywhere."""

NO_POSES: Floats = np.zeros((0, 4, 4))

_SMALL_ANGLE = 1e-5
# A copy takes a tenth of the time that making one takes.
_UNMOVED: Floats = np.eye(4)
_UNTURNED: Floats = np.eye(3)


def make_pose(rotation: Array, translation: Array) -> Floats:
    """A pose from a 3 × 3 rotation matrix and a translation (3,) in metres."""
    pose: Floats = _UNMOVED.copy()
    pose[:3, :3] = rotation
    pose[:3, 3] = translation
    return pose


def invert(pose: Floats) -> Floats:
    """``b_from_a`` of ``a_from_b``."""
    rotation = pose[:3, :3].T
    return make_pose(rotation, -rotation @ pose[:3, 3])


def transform(pose: Floats, points: Floats) -> Floats:
    """Points (..., 3) of frame b in frame a."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def hat(vector: Array) -> Floats:
    """The skew-symmetric matrix of a cross product: ``hat(a) @ b = a × b``."""
    x, y, z = (float(part) for part in vector)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross(first: Floats, second: Floats) -> Floats:
    """Cross products (n, 3) of the rows; numpy's own spends more time on axes than on numbers."""
    a, b = first.T, second.T
    return np.stack((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]), axis=1)


def unit(vectors: Floats) -> Floats:
    """Vectors (..., 3) made as long as 1; zeros stay."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def looking_down(azimuth_rad: float, elevation_rad: float, radius_m: float, target_m: Array) -> Floats:
    """world_from_camera of a camera that looks at a target from a direction, so far away, upright."""
    flat = np.cos(elevation_rad)
    away = np.array([np.cos(azimuth_rad) * flat, np.sin(azimuth_rad) * flat, np.sin(elevation_rad)])
    right = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    return make_pose(np.stack((right, np.cross(-away, right), -away), axis=1), target_m + radius_m * away)


def exp_so3(rotation: Array) -> Floats:
    """The rotation matrix of a rotation vector (axis times angle, radians)."""
    first, second, _ = _series(_length(rotation))
    cross = hat(rotation)
    return _UNTURNED + first * cross + second * cross @ cross


def log_so3(rotation: Array) -> Floats:
    """The rotation vector (angle in [0, π]) of a rotation matrix."""
    x, y, z, w = quaternion_of(rotation).tolist()
    length = sqrt(x * x + y * y + z * z)
    scale = 2.0 if length < 1e-12 else 2.0 * atan2(length, w) / length
    return np.array((scale * x, scale * y, scale * z))


def exp_se3(twist: Array) -> Floats:
    """The rigid motion of a twist (6,): translation part, then rotation part."""
    rotation = np.asarray(twist[3:], dtype=np.float64)
    first, second, third = _series(_length(rotation))
    cross = hat(rotation)
    square = cross @ cross
    left = _UNTURNED + second * cross + third * square
    return make_pose(_UNTURNED + first * cross + second * square, left @ twist[:3])


def log_se3(pose: Floats) -> Floats:
    """The twist (6,) of a rigid motion: inverse of `exp_se3` for angles below π."""
    rotation = log_so3(pose[:3, :3])
    _, second, third = _series(_length(rotation))
    cross = hat(rotation)
    left = _UNTURNED + second * cross + third * cross @ cross
    return np.concatenate((np.linalg.solve(left, pose[:3, 3]), rotation))


def orthonormal(pose: Floats) -> Floats:
    """The same pose with its rotation made exactly orthonormal (nearest in the least-squares sense)."""
    left, _, right = np.linalg.svd(pose[:3, :3])
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return make_pose(left @ sign @ right, pose[:3, 3])


def quaternion_of(rotation: Array) -> Floats:
    """The unit quaternion (x, y, z, w), w ≥ 0, of a rotation matrix."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, dtype=np.float64).tolist()
    # Each row is the quaternion times four times one of its parts; the largest part is the safe one.
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    x, y, z, w = rows[squares.index(max(squares))]
    scale = (-1.0 if w < 0.0 else 1.0) / sqrt(x * x + y * y + z * z + w * w)
    return np.array((scale * x, scale * y, scale * z, scale * w))


def rotation_of(quaternion: Array) -> Floats:
    """The rotation matrix of a quaternion (x, y, z, w), which is normalised first."""
    x, y, z, w = np.asarray(quaternion, dtype=np.float64).tolist()
    scale = 1.0 / sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = scale * x, scale * y, scale * z, scale * w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_error(first: Floats, second: Floats) -> tuple[float, float]:
    """How far two poses of one frame are apart: metres between the origins, radians between the axes."""
    distance = float(np.linalg.norm(first[:3, 3] - second[:3, 3]))
    angle = float(np.linalg.norm(log_so3(first[:3, :3].T @ second[:3, :3])))
    return distance, angle


def project(points: Floats, intrinsics: Array) -> Floats:
    """Pixels (..., 2) of points (..., 3) in the camera's frame, metres, z > 0, by fx, fy, cx, cy in pixels."""
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    inverse = 1.0 / points[..., 2]
    return np.stack((fx * points[..., 0] * inverse + cx, fy * points[..., 1] * inverse + cy), axis=-1)


def rays(pixels: Array, intrinsics: Array) -> Floats:
    """Directions (..., 3) with z = 1 through pixels (..., 2): times the depth they are points in the camera's frame."""
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    pixels = np.asarray(pixels, dtype=np.float64)
    x = (pixels[..., 0] - cx) / fx
    return np.stack((x, (pixels[..., 1] - cy) / fy, np.ones_like(x)), axis=-1)


def is_behind(points: Floats, pose: Floats, box: Floats, margin_m: float = 0.0) -> Array:
    """(n,) whether a box (2, 3), its low and its high corner in its own frame, at a pose hides points (n, 3): it is
    nearer to the camera than they are, by more than a margin. All in the camera's frame."""
    to_box = invert(pose)
    eye, ends = to_box[:3, 3], transform(to_box, points)
    ways = ends - eye
    ways = np.where(np.abs(ways) < 1e-9, 1e-9, ways)
    sides = (box[:, None] - eye) / ways
    enters, leaves = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
    lengths = np.linalg.norm(ways, axis=1)
    return np.asarray((enters < leaves) & (leaves > 0.0) & ((1.0 - enters) * lengths > margin_m))


def _length(vector: Array) -> float:
    """That of (3,): numpy's own norm takes far longer."""
    x, y, z = (float(part) for part in vector)
    return sqrt(x * x + y * y + z * z)


def _series(angle: float) -> tuple[float, float, float]:
    """sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³."""
    square = angle * angle
    if angle < _SMALL_ANGLE:
        return 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    sine, half = sin(angle), sin(0.5 * angle)
    return sine / angle, 2.0 * half * half / square, (angle - sine) / (square * angle)
