"""What is to be seen in a picture of a page."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.runtime.core.showing import PALETTE

Picture = NDArray[np.uint8]


def decoded(png: bytes) -> Picture:
    """A picture's pixels, RGB."""
    picture: Any = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(picture[..., ::-1], np.uint8)


def part(picture: Picture, box: tuple[int, int, int, int]) -> Picture:
    """A part of a picture: left, top, right, bottom."""
    left, top, right, bottom = box
    return picture[top:bottom, left:right]


def pixels_like(picture: Picture, colour: tuple[int, ...], within: int = 40) -> int:
    """How many pixels are about of a colour."""
    return int((np.abs(picture.astype(int) - np.array(colour)).max(axis=2) <= within).sum())


def hues(picture: Picture, bodies: int, least: int = 10) -> int:
    """How many of so many bodies' colours are there, in whatever light."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
    strong = hsv[(hsv[..., 1] > 90) & (hsv[..., 2] > 50)][:, 0].astype(int)
    palette = cv2.cvtColor(np.array([PALETTE[:bodies]], np.uint8), cv2.COLOR_RGB2HSV)[0, :, 0].astype(int)
    apart = np.abs(strong[:, None] - palette)
    return int(((np.minimum(apart, 180 - apart) <= 5).sum(axis=0) >= least).sum())


def drawn(picture: Picture) -> int:
    """How many pixels are unlike the ground; what colour text has depends on the viewer's version."""
    ground = np.median(picture.reshape(-1, 3), axis=0)
    return picture.shape[0] * picture.shape[1] - pixels_like(picture, tuple(ground), 60)
