"""Corners of a model that a user can tell in a picture, and the pose by where they are in it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import (
    NEAREST_M,
    Array,
    Floats,
    lens_matrix,
    make_pose,
    project,
    transform,
    unit,
)
from hierax.nodes.tracking.model.shapes import Shape

LEAST = 4  # corners by which a pose is told
_MOST = 16  # corners that are asked for
_TURN = 0.9  # cosine of the angle up to which two edges that meet turn into one another
_MOST_OFF_PX, _MOST_OFF = 4.0, 0.03  # largest error of a pose: pixels, or share of how far apart the clicks are


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
    rows = np.column_stack(
        ((corners - corners.mean(axis=0) if len(corners) else corners) / scale, np.ones(len(corners)))
    )
    spanned, chosen = 1e-3 * np.eye(4), list[int]()
    while len(chosen) < min(_MOST, len(corners)):
        # what the determinant of the corners' moments grows by
        gains = np.einsum("ni,ij,nj->n", rows, np.linalg.inv(spanned), rows)
        gains[chosen] = -1.0
        chosen.append(int(gains.argmax()))
        spanned += np.outer(rows[chosen[-1]], rows[chosen[-1]])
    return corners[chosen]


def fitted(corners: Floats, pixels: Floats, intrinsics: Array) -> Fit | None:
    """The pose that puts corners nearest to where they were clicked; None where there is none before the camera.

    Args:
        corners: (n, 3) object's frame, at least `LEAST`; pixels: (n, 2); intrinsics: fx, fy, cx, cy in pixels.
    """
    lens, best = lens_matrix(intrinsics), None
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(corners, pixels, lens, None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # they are on a line, say
        return None
    for turn, shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(corners, pixels, lens, None, turn, shift)
        pose = make_pose(cv2.Rodrigues(turn)[0], shift.ravel())
        fit = _judged(pose, corners, pixels, intrinsics)
        if fit is not None and (best is None or fit.off_px < best.off_px):
            best = fit
    return best


def _judged(pose: Floats, corners: Floats, pixels: Floats, intrinsics: Array) -> Fit | None:
    seen = transform(pose, corners)
    if not np.isfinite(seen).all() or seen[:, 2].min() < NEAREST_M:
        return None
    away = np.linalg.norm(project(seen, intrinsics) - pixels, axis=1)
    off_px = float(np.sqrt((away**2).mean()))
    apart = float(np.linalg.norm(np.ptp(pixels, axis=0)))
    return Fit(pose, off_px, int(away.argmax()), off_px < max(_MOST_OFF_PX, _MOST_OFF * apart))
