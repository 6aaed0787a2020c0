"""Tags on the table, drawn into pictures."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.sources.shots import lens_matrix
from hierax.nodes.tracking.math.geometry import Array, Floats, invert

GAMMA = 2.2
_CELL_PX, _SAMPLES, _BLUR_PX, _NOISE = 20, 4, 0.7, 2.5
_DARK, _BRIGHT = 0.02, 0.6


def draw_tag(
    picture: Array, camera: Floats, intrinsics: Array, side_m: float, rng: np.random.Generator, tag: tuple[int, int]
) -> NDArray[np.uint8]:
    """A picture with a tag, a square of white around it, over whatever stands there.

    Args:
        picture: uint8 RGB, or gray; camera: tag_from_camera; intrinsics: fx, fy, cx, cy in pixels.
        side_m: of the black square; rng: draws the noise; tag: OpenCV's dictionary and the number in it.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(tag[0])
    cells = dictionary.markerSize + 2
    black = cv2.aruco.generateImageMarker(dictionary, tag[1], cells * _CELL_PX)
    pattern = np.pad(black, _CELL_PX, constant_values=255).astype(np.float32) / 255.0
    metres = side_m / (cells * _CELL_PX)
    start = -side_m / 2 - (_CELL_PX - 0.5) * metres
    on_table = np.array([[metres, 0.0, start], [0.0, -metres, -start], [0.0, 0.0, 1.0]])
    seen = invert(camera)
    finer = np.array([[_SAMPLES, 0, _SAMPLES / 2 - 0.5], [0, _SAMPLES, _SAMPLES / 2 - 0.5], [0, 0, 1]])
    to_pixels = finer @ lens_matrix(intrinsics) @ seen[:3][:, [0, 1, 3]] @ on_table
    height, width = picture.shape[:2]
    layers: Any = cv2.merge([_DARK + (_BRIGHT - _DARK) * pattern, np.ones_like(pattern)])
    drawn = cv2.warpPerspective(layers, to_pixels, (width * _SAMPLES, height * _SAMPLES))
    drawn = cv2.GaussianBlur(cv2.resize(drawn, (width, height), interpolation=cv2.INTER_AREA), (0, 0), _BLUR_PX)
    light, there = drawn[..., 0], drawn[..., 1]
    if picture.ndim == 3:
        light, there = light[..., None], there[..., None]
    whole = light + (1.0 - there) * (picture / 255.0) ** GAMMA
    noise = np.where(there > 0.5, _NOISE, 0.0) * rng.standard_normal(picture.shape)
    return np.asarray(np.clip(np.rint(255.0 * whole ** (1.0 / GAMMA) + noise), 0, 255), np.uint8)
