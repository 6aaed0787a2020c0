"""The camera: what comes of light on its way into a picture file.

A picture is exposed row by row, while things move; the lens blurs it and darkens its corners; exposure wanders; light
comes in quanta and the sensor adds noise; then it is encoded, sharpened in some cameras, and squeezed in some.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from layouts import FPS, Scene
from stage import SIZE

from hierax.nodes.tracking.math.geometry import Array

_SUBFRAMES = 3  # pictures that are added up in one exposure
_GAMMA = 2.2
_DECODED = ((np.arange(256) / 255.0) ** _GAMMA).astype(np.float32)


class Lens(NamedTuple):
    """A camera's properties, drawn for each scene."""

    exposure_s: float  # of each row
    readout_s: float  # from the first row to the last one
    blur_px: float  # standard deviation
    quanta: float  # that white is made of
    noise: float  # of the sensor, standard deviation in parts of white
    corner: float  # what the corners lose of light
    wander: float  # how far exposure goes up and down, in parts
    sharpening: float  # 0 for none
    jpeg: int  # quality, 0 for none
    lamp_m: float  # the lamps' radius, which softens shadows


def random_lens(rng: np.random.Generator) -> Lens:
    """Some camera."""
    return Lens(
        exposure_s=rng.uniform(0.003, 0.012),
        readout_s=rng.uniform(0.002, 0.008),
        blur_px=rng.uniform(0.4, 0.9),
        quanta=rng.uniform(2000.0, 8000.0),
        noise=rng.uniform(0.001, 0.004),
        corner=rng.uniform(0.05, 0.3),
        wander=rng.uniform(0.0, 0.06),
        sharpening=float(rng.choice([0.0, 0.0, 0.3])),
        jpeg=int(rng.choice([0, 88, 94])),
        lamp_m=rng.uniform(0.005, 0.04),
    )


def photograph(scene: Scene, lens: Lens, frame: int, gain: float, rng: np.random.Generator) -> Array:
    """A frame, uint8 RGB; the truth is that of the middle row's middle instant, `frame` / `FPS`.

    Args:
        scene, lens: what is seen by what; frame: which; gain: of the sensor; rng: draws the noise.
    """
    light = exposed(scene, lens, frame) * gain * (1.0 + lens.wander * np.sin(frame / 11.0))
    light = cv2.GaussianBlur(light, (0, 0), lens.blur_px)
    x, y = np.meshgrid(np.linspace(-1, 1, SIZE[0]), np.linspace(-0.75, 0.75, SIZE[1]))
    light *= (1.0 - lens.corner * (x * x + y * y) / 1.5625)[..., None]
    spread = np.sqrt(np.clip(light, 0, None) / lens.quanta + lens.noise**2)
    light = np.clip(light + spread * rng.standard_normal(light.shape), 0.0, 1.0)
    picture = 255.0 * light ** (1.0 / _GAMMA)
    if lens.sharpening:
        picture += lens.sharpening * (picture - cv2.GaussianBlur(picture, (0, 0), 1.2))
    made: Array = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return squeezed(made, lens.jpeg) if lens.jpeg else made


def squeezed(picture: Array, quality: int) -> Array:
    """What JPEG leaves of a picture, uint8 RGB; quality: 1 to 100."""
    # OpenCV takes the first channel for blue: as it is, what the eye sees least would be kept best.
    _, content = cv2.imencode(".jpg", picture[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, quality))
    return np.ascontiguousarray(cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1])


def gain_of(scene: Scene, lens: Lens) -> float:
    """What makes the first frame neither dark nor bright."""
    return float(np.clip(0.24 / exposed(scene, lens, 0).mean(), 0.6, 3.0))


def exposed(scene: Scene, lens: Lens, frame: int) -> Array:
    """Light on the sensor, float32 (h, w, 3), each row's from its own span of time."""
    whole = lens.exposure_s + lens.readout_s
    ends = np.linspace(-whole / 2, whole / 2, _SUBFRAMES + 1)
    middles = lens.readout_s * np.linspace(-0.5, 0.5, SIZE[1])
    light = np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    for number, (begin, end) in enumerate(pairwise(ends)):
        time_s = frame / FPS + (begin + end) / 2
        turn = 2.0 * np.pi * number / _SUBFRAMES
        scene.stage.resume(scene.state(time_s))
        shift = lens.lamp_m * np.array([np.cos(turn), np.sin(turn), 0.0])
        picture = _DECODED[scene.stage.draw(scene.camera(time_s), shift)]
        shared = np.minimum(end, middles + lens.exposure_s / 2) - np.maximum(begin, middles - lens.exposure_s / 2)
        weights = np.clip(shared, 0.0, None) / lens.exposure_s
        light += weights[:, None, None].astype(np.float32) * cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
    return light
