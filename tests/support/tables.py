"""A table with a texture, as cameras see it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import invert
from support.boxes import INTRINSICS, SIZE

_PIXELS_M, _SIDE_PX = 800.0, 1600  # of the texture; the table's middle is its middle


def _texture() -> np.ndarray[Any, Any]:
    blots = np.random.default_rng(7).normal(size=(_SIDE_PX, _SIDE_PX))
    blurred = cv2.GaussianBlur(blots, (0, 0), 4.0)
    return np.asarray(110.0 + 25.0 * blurred / blurred.std())


TEXTURE = _texture()


def table_seen(camera: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """(h, w) grey levels of a table in the plane z = 0, blots of some five millimetres; camera: world_from_camera."""
    fx, fy, cx, cy = INTRINSICS
    seen = invert(camera)
    pixels = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]) @ seen[:3, [0, 1, 3]]
    shift = -_SIDE_PX / 2 / _PIXELS_M
    metres = np.array([[1.0 / _PIXELS_M, 0.0, shift], [0.0, 1.0 / _PIXELS_M, shift], [0.0, 0.0, 1.0]])
    found = cv2.warpPerspective(TEXTURE, pixels @ metres, SIZE, flags=cv2.INTER_LINEAR, borderValue=110.0)
    return np.clip(found, 0.0, 255.0)
