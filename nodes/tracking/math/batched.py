"""Rigid poses by the dozen: the same as in `geometry`, for stacks (m, 4, 4) and (m, 6) at once."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats, cross

Table = TypeVar("Table", bound=NamedTuple)

_SMALL = 1e-8
_SMALL_SQUARE = 1e-6
_FEW = 12  # so many exponentials and logarithms take less time one by one: numpy spends more on a call than on numbers


def exp_many(twists: Floats) -> Floats:
    """The rigid motions (m, 4, 4) of twists (m, 6): translation part, then rotation part."""
    if len(twists) <= _FEW:
        return np.array([_exp(*twist) for twist in twists.tolist()], dtype=np.float64).reshape(-1, 4, 4)
    rotation = twists[:, 3:]
    square = np.einsum("mk,mk->m", rotation, rotation)
    first, second, third = _series(square)
    once = hat_many(rotation)
    twice = once @ once
    poses = np.zeros((len(twists), 4, 4))
    poses[:, :3, :3] = np.eye(3) + first * once + second * twice
    poses[:, :3, 3] = ((np.eye(3) + second * once + third * twice) @ twists[:, :3, None])[..., 0]
    poses[:, 3, 3] = 1.0
    return poses


def log_many(poses: Floats) -> Floats:
    """The twists (m, 6) of rigid motions by less than half a turn."""
    if len(poses) <= _FEW:
        return np.array([_log(*pose) for pose in poses[:, :3].tolist()], dtype=np.float64).reshape(-1, 6)
    skew = 0.5 * (poses[:, :3, :3] - poses[:, :3, :3].transpose(0, 2, 1))
    axis = np.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), axis=1)
    sine = np.sqrt(np.einsum("mk,mk->m", axis, axis))
    cosine = 0.5 * (np.trace(poses[:, :3, :3], axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    rotation = axis * np.where(sine < _SMALL, 1.0, angle / np.maximum(sine, _SMALL))[:, None]
    first, second, _ = _series(angle * angle)
    square = (angle * angle)[:, None]
    # What takes the translation back: 1 - [w]/2 + (1 - first/(2 second))/angle² [w]².
    last = np.where(
        square < _SMALL_SQUARE, 1.0 / 12.0, (1.0 - 0.5 * (first / second)[..., 0]) / np.maximum(square, _SMALL)
    )
    moved = poses[:, :3, 3]
    once = cross(rotation, moved)
    return np.concatenate((moved - 0.5 * once + last * cross(rotation, once), rotation), axis=1)


def invert_many(poses: Floats) -> Floats:
    """``b_from_a`` of each ``a_from_b``."""
    back = np.zeros_like(poses)
    back[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    back[:, :3, 3] = -(back[:, :3, :3] @ poses[:, :3, 3, None])[..., 0]
    back[:, 3, 3] = 1.0
    return back


def adjoints(poses: Floats) -> Floats:
    """(m, 6, 6) what twists are, seen from another frame: ``pose @ exp(twist) = exp(adjoint @ twist) @ pose``."""
    carried = np.zeros((len(poses), 6, 6))
    carried[:, :3, :3] = carried[:, 3:, 3:] = poses[:, :3, :3]
    carried[:, :3, 3:] = hat_many(poses[:, :3, 3]) @ poses[:, :3, :3]
    return carried


def hat_many(vectors: Floats) -> Floats:
    """The skew-symmetric matrices (m, 3, 3) of cross products with vectors (m, 3)."""
    half = np.zeros((len(vectors), 3, 3))
    half[:, 2, 1], half[:, 0, 2], half[:, 1, 0] = vectors.T
    return np.asarray(half - half.transpose(0, 2, 1))


def solved(matrices: Floats, right: Floats) -> Floats:
    """x of ``matrices @ x = right``, as `numpy.linalg.solve` has it."""
    return np.asarray(np.linalg.solve(matrices, right), dtype=np.float64)


def inverse(matrices: Floats) -> Floats:
    """The inverses (m, n, n) of symmetric, positive definite matrices, symmetric again."""
    found = np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    return np.asarray(0.5 * (found + np.swapaxes(found, -1, -2)))


def only(table: Table, chosen: Array) -> Table:
    """The chosen rows of all arrays of a named tuple."""
    return table._make(part[chosen] for part in table)


def joined(tables: Sequence[Table]) -> Table:
    """Named tuples of arrays, one behind the other."""
    return tables[0]._make(np.concatenate(parts) for parts in zip(*tables, strict=True))


def placed(poses: Floats, owners: Array, points: Floats) -> Floats:
    """Points (n, 3) in the camera's frame, by the poses (m, 4, 4) of the objects (n,) that they are on."""
    return np.asarray((poses[owners, :3, :3] @ points[:, :, None])[..., 0] + poses[owners, :3, 3])


def pixels_of(seen: Floats, intrinsics: Array) -> Floats:
    """Pixels (n, 2) of points (n, 3) in the camera's frame; what is nearer than `NEAREST_M` counts as that far away."""
    return np.asarray(seen[:, :2] / np.maximum(seen[:, 2:], NEAREST_M) * intrinsics[:2] + intrinsics[2:])


def pixels_along(normals: Floats, seen: Floats, intrinsics: Array) -> Floats:
    """(n, 3) by how many pixels along normals (n, 2) points (n, 3) move in the image for each metre, camera's frame."""
    inverse = 1.0 / np.maximum(seen[:, 2], NEAREST_M)
    across, down = normals[:, 0] * intrinsics[0] * inverse, normals[:, 1] * intrinsics[1] * inverse
    return np.stack((across, down, -(across * seen[:, 0] + down * seen[:, 1]) * inverse), axis=1)


def found_among(known: Array, wanted: Array) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Whether each of the wanted numbers is among the known ones (n,), ascending and at least one; and where."""
    place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    return np.asarray(known[place] == wanted), place


def tukey(residuals: Floats, end: Floats | float) -> Floats:
    """Tukey's weight of residuals (n,), 0 to 1: 0 from `end` on."""
    part = np.minimum(np.abs(residuals) / end, 1.0)
    return np.asarray((1.0 - part * part) ** 2)


def summed(owners: Array, values: Floats, count: int) -> Floats:
    """(count,) the sums of what values (n,) each owner has."""
    return np.asarray(np.bincount(owners, weights=values, minlength=count), dtype=np.float64)


def _series(square: Floats) -> tuple[Floats, Floats, Floats]:
    """sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³ of squared angles, shaped (m, 1, 1)."""
    small = square < 1e-8
    safe = np.where(small, 1.0, square)
    angle = np.sqrt(safe)
    sine = np.sin(angle)
    half = np.sin(0.5 * angle)
    first = np.where(small, 1.0 - square / 6.0, sine / angle)
    second = np.where(small, 0.5 - square / 24.0, 2.0 * half * half / safe)
    third = np.where(small, 1.0 / 6.0 - square / 120.0, (angle - sine) / (safe * angle))
    return first[:, None, None], second[:, None, None], third[:, None, None]


def _exp(x: float, y: float, z: float, a: float, b: float, c: float) -> list[float]:
    """The 16 numbers of a rigid motion, by its twist: with w = (a, b, c), [w]² = w wᵀ − θ²."""
    square = a * a + b * b + c * c
    first, second, third = _series_of(square)
    on, level = first, 1.0 - second * square  # of the rotation: [w] times `on`, identity times `level`
    ab, ac, bc = second * a * b, second * a * c, second * b * c
    along, flat = third * (a * x + b * y + c * z), 1.0 - third * square
    return [
        *(level + second * a * a, ab - on * c, ac + on * b, flat * x + second * (b * z - c * y) + along * a),
        *(ab + on * c, level + second * b * b, bc - on * a, flat * y + second * (c * x - a * z) + along * b),
        *(ac - on * b, bc + on * a, level + second * c * c, flat * z + second * (a * y - b * x) + along * c),
        *(0.0, 0.0, 0.0, 1.0),
    ]


def _log(first: list[float], second: list[float], third: list[float]) -> list[float]:
    """The twist of a rigid motion by less than half a turn, by its upper three rows."""
    a, b, c = 0.5 * (third[1] - second[2]), 0.5 * (first[2] - third[0]), 0.5 * (second[0] - first[1])
    sine = math.sqrt(a * a + b * b + c * c)
    angle = math.atan2(sine, 0.5 * (first[0] + second[1] + third[2] - 1.0))
    scale = 1.0 if sine < _SMALL else angle / sine
    a, b, c = scale * a, scale * b, scale * c
    square = angle * angle
    once, twice, _ = _series_of(square)
    last = 1.0 / 12.0 if square < _SMALL_SQUARE else (1.0 - 0.5 * once / twice) / square
    x, y, z = first[3], second[3], third[3]
    p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
    return [
        x - 0.5 * p + last * (b * r - c * q),
        y - 0.5 * q + last * (c * p - a * r),
        z - 0.5 * r + last * (a * q - b * p),
        *(a, b, c),
    ]


def _series_of(square: float) -> tuple[float, float, float]:
    """As `_series`, of one squared angle."""
    if square < _SMALL:
        return 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    angle = math.sqrt(square)
    sine, half = math.sin(angle), math.sin(0.5 * angle)
    return sine / angle, 2.0 * half * half / square, (angle - sine) / (square * angle)
