"""Looks: what tables and bodies are covered with, as pictures; and paints, of which neighbours may share one."""

from __future__ import annotations

import colorsys

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats

TABLES = ("planks", "checks", "stripes", "terrazzo", "print", "felt")
_TABLE_PX, _PAINT_PX = 2048, 256


def table(rng: np.random.Generator, pattern: str) -> bytes:
    """A table's picture as PNG: square, of one of the `TABLES`."""
    base = _hsv(rng.uniform(0, 1), rng.uniform(0.05, 0.4), rng.uniform(0.45, 0.85))
    side = np.arange(_TABLE_PX)
    x, y = np.meshgrid(side, side)
    level = 1.0 + 0.03 * _cloud(rng, _TABLE_PX, 8) + 0.02 * _cloud(rng, _TABLE_PX, 256)
    if pattern == "planks":
        width = int(rng.integers(90, 220))
        tone = rng.uniform(0.8, 1.15, _TABLE_PX // width + 1)[y // width]
        grain = cv2.resize(_cloud(rng, _TABLE_PX, 512), None, fx=24, fy=1)[:, :_TABLE_PX]
        level *= tone * (1.0 + 0.07 * grain) * np.where(y % width < 3, 0.6, 1.0)
    elif pattern == "checks":
        width = int(rng.integers(60, 130))
        level *= np.where((x // width + y // width) % 2, 1.0, rng.uniform(0.6, 0.85))
    elif pattern == "stripes":
        widths = rng.integers(15, 90, 200)
        level *= rng.uniform(0.65, 1.15, 200)[np.searchsorted(widths.cumsum(), side)][None, :]
    elif pattern == "terrazzo":
        level *= _strewn(rng, 2600, (4, 22), 0.35)
    elif pattern == "print":
        level *= _printed(rng)
    picture = base[None, None] * level[..., None]
    if pattern in ("terrazzo", "print"):
        picture *= 1.0 + 0.02 * np.stack([_cloud(rng, _TABLE_PX, 24) for _ in range(3)], axis=-1)
    return _png(picture)


def plain_table(rng: np.random.Generator, grey: float) -> bytes:
    """A table of about one grey, from 0 to 1."""
    level = grey * (1.0 + 0.025 * _cloud(rng, _TABLE_PX, 8) + 0.02 * _cloud(rng, _TABLE_PX, 256))
    return _png(level[..., None] * np.array([1.0, 0.99, 0.97]))


def paint(rng: np.random.Generator, colour: Floats, labelled: bool) -> bytes:
    """A body's picture as PNG: a little uneven, with something printed on it where it is `labelled`."""
    level = 1.0 + 0.03 * _cloud(rng, _PAINT_PX, 4) + rng.uniform(0.01, 0.04) * _cloud(rng, _PAINT_PX, 64)
    if labelled:
        sign = 1.0 + rng.choice([-1, 1]) * rng.uniform(0.12, 0.35)
        low, high = np.sort(rng.integers(40, 216, (2, 2)), axis=0)
        if rng.random() < 0.5:
            level[low[1] : high[1] + 12, low[0] : high[0] + 12] *= sign
        else:
            disc = cv2.circle(
                np.zeros_like(level), (128, 128), int(rng.integers(25, 70)), 1.0, int(rng.choice([-1, 14]))
            )
            level *= np.where(disc > 0, sign, 1.0)
    return _png(colour[None, None] * level[..., None])


def colours(rng: np.random.Generator, count: int, different: int) -> Floats:
    """(count, 3) paints of so few different ones that neighbours share them, each a little off."""
    hue = rng.uniform(0, 1)
    few = [
        _hsv(hue + at / different + rng.uniform(-0.08, 0.08), rng.uniform(0.2, 0.8), rng.uniform(0.4, 0.9))
        for at in range(different)
    ]
    chosen = np.array([few[at] for at in rng.permutation(np.arange(count) % different)])
    return chosen * rng.uniform(0.94, 1.06, (count, 1)) + rng.uniform(-0.012, 0.012, (count, 3))


def greys(rng: np.random.Generator, count: int, middle: float) -> Floats:
    """(count, 3) greys, hardly different, from 0 to 1."""
    return middle * (1.0 + rng.uniform(-0.09, 0.09, (count, 1)) + rng.uniform(-0.012, 0.012, (count, 3)))


def _cloud(rng: np.random.Generator, size: int, cells: int) -> Array:
    """Smooth noise (size, size) with a standard deviation of about 1."""
    coarse = rng.standard_normal((cells, cells)).astype(np.float32)
    return cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)


def _strewn(rng: np.random.Generator, count: int, radii: tuple[int, int], contrast: float) -> Array:
    level = np.ones((_TABLE_PX, _TABLE_PX), np.float32)
    places = rng.integers(0, _TABLE_PX, (count, 2))
    for place, size, value in zip(
        places, rng.integers(*radii, (count, 2)), rng.normal(1.0, contrast, count), strict=True
    ):
        around = tuple(int(part) for part in place)
        cv2.ellipse(level, (around, (int(size[0]), int(size[1])), float(rng.uniform(0, 180))), float(value), -1)
    return np.clip(level, 0.4, 1.5)


def _printed(rng: np.random.Generator) -> Array:
    """Lines of blocks, as of a newspaper."""
    level = np.ones((_TABLE_PX, _TABLE_PX), np.float32)
    for top in range(0, _TABLE_PX, 22):
        at = 0
        while at < _TABLE_PX:
            width = int(rng.integers(8, 60))
            level[top : top + 11, at : at + width] = rng.uniform(0.45, 0.7)
            at += width + int(rng.integers(8, 16))
    return level


def _hsv(hue: float, saturation: float, value: float) -> Floats:
    return np.array(colorsys.hsv_to_rgb(hue % 1.0, saturation, value))


def _png(picture: Array) -> bytes:
    content = cv2.imencode(".png", np.clip(255.0 * picture[..., ::-1], 0, 255).astype(np.uint8))[1]
    return bytes(content.tobytes())
