"""Drawn letters: strokes, and a sign that goes from H to A by degrees."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

cv2.setNumThreads(1)  # equal pixels in every run, and no threads in the nodes' processes

PAPER = 200  # grey value of the ground; far enough from 255 for noise to stay Gaussian
INK = 56  # grey value of the strokes
AMBIGUOUS = "?"  # the sign between H and A
GREYS = np.dtype(np.uint8)

Picture = np.ndarray[Any, np.dtype[np.uint8]]
Stroke = np.ndarray[Any, np.dtype[np.float64]]  # corners (n, 2) in a unit square, x to the right and y down

_FRACTION_BITS = 6
_BOW = [(0.54 + 0.34 * math.cos(math.radians(a)), 0.5 + 0.35 * math.sin(math.radians(a))) for a in range(45, 316, 15)]
_CORNERS: dict[str, list[list[tuple[float, float]]]] = {
    "A": [[(0.22, 0.86), (0.5, 0.14)], [(0.78, 0.86), (0.5, 0.14)], [(0.36, 0.5), (0.64, 0.5)]],
    "C": [_BOW],
    "E": [[(0.72, 0.14), (0.3, 0.14), (0.3, 0.86), (0.72, 0.86)], [(0.3, 0.5), (0.66, 0.5)]],
    "H": [[(0.22, 0.86), (0.22, 0.14)], [(0.78, 0.86), (0.78, 0.14)], [(0.22, 0.5), (0.78, 0.5)]],
    "T": [[(0.2, 0.16), (0.8, 0.16)], [(0.5, 0.16), (0.5, 0.86)]],
}
# Each letter's strokes. H and A have the same ones, in other places.
_STROKES = {letter: [np.array(stroke) for stroke in strokes] for letter, strokes in _CORNERS.items()}

DRAWN = tuple(_STROKES)  # the letters that can be drawn


def strokes(sign: str, ambiguity: float) -> list[Stroke]:
    """The strokes of a letter, or of the sign between H and A.

    Args: sign: one of `DRAWN`, or `AMBIGUOUS`. ambiguity: how far `AMBIGUOUS` is on the way from H (0) to A (1): the
        uprights lean together.
    """
    if sign != AMBIGUOUS:
        return _STROKES[sign]
    return [(1.0 - ambiguity) * h + ambiguity * a for h, a in zip(_STROKES["H"], _STROKES["A"], strict=True)]


@lru_cache(maxsize=256)
def draw_glyph(sign: str, ambiguity: float, size: int) -> Picture:
    """A sign as grey values, shape (size, size), uint8, read-only."""
    picture = np.full((size, size), PAPER, GREYS)
    scale = size * (1 << _FRACTION_BITS)
    for stroke in strokes(sign, ambiguity):
        points = np.rint(stroke * scale).astype(np.int32)
        cv2.polylines(picture, [points], False, INK, max(1, size // 10), cv2.LINE_AA, _FRACTION_BITS)
    picture.flags.writeable = False
    return picture


def draw_picture(letters: str, ambiguity: float, size: int) -> Picture:
    """Signs in a row, shape (size, size × their number), uint8."""
    return np.hstack([draw_glyph(sign, ambiguity, size) for sign in letters])
