"""How pictures encode light, and how far that moves edges.

A lens adds up light; what a picture holds of it is encoded, about by its square root, so that a step between dark and
bright is steeper at its dark end: its place is found too far in the dark, in proportion to the blur and, nearly, to the
contrast of the two sides, (a - b)/(a + b). An object on darker ground seems larger by that all around, and so nearer.
The factor in pixels is one for the whole picture, the same in every picture of a camera: it is learned from edges of
which some are bright inside and some outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.estimation.profiles import Profiles, Singles
from hierax.nodes.tracking.math.batched import solved
from hierax.nodes.tracking.math.geometry import Array, Floats

# Pictures that hold light as it is have 0; those of a sharp lens, encoded as screens want it, 0.2.
USUAL_PX = 0.05
_SPREAD_PX = 0.2

_MOST_PX = 0.4  # of blurred pictures; less than nothing it never is, though shadows beside objects may make it seem so
_LEAST_LIGHT = 4.0  # grey levels: of two sides in the dark the contrast says nothing

# Over so many images what an object tells is added up: one's edges err alike in images that are much the same.
_IMAGES = 30.0

_EASE = 1e-3  # share of an object's information that is added, so that what no edge shows of its pose stays finite
UNTOLD: Floats = np.zeros(2)  # what an object has told so far: its information, 1/px², and that times the factor


class Tone(NamedTuple):
    """What control points say of the factor, around some poses."""

    couplings: Floats  # (m, 12) of each object between the factor and twists (of the camera's frame, of the object's)
    weights: Floats  # (m,) information, 1/px², were the poses known
    slopes: Floats  # (m,) gradient of the image's loss over the factor


def contrasts(profiles: Profiles) -> Singles:
    """(n, k) of each peak by how much it is brighter inside than outside, -1 to 1."""
    inside, outside = profiles.inside.mean(axis=2), profiles.outside.mean(axis=2)
    found: Singles = (inside - outside) / np.maximum(inside + outside, np.float32(_LEAST_LIGHT))
    return found


def believed(told: list[Floats]) -> tuple[float, float]:
    """The factor by what all objects have told, and its information, 1/px²."""
    known = 1.0 / _SPREAD_PX**2
    weight, product = np.sum([*told, UNTOLD], axis=0)
    factor = np.clip((known * USUAL_PX + product) / (known + weight), 0.0, _MOST_PX)
    return float(factor), float(known + weight)


def told_by(tone: Tone, blocks: Floats, slopes: Floats) -> Floats:
    """(m, 2) what each object tells in one image when its pose has been fitted as well: information, and that times
    by how much the factor should be more than it was taken to be.

    Args:
        tone: at some poses; blocks: (m, 12, 12) information about twists there; slopes: (m, 12) gradient over them.
    """
    own = blocks[:, 6:, 6:]
    eased = own + _EASE * own * np.eye(6) + 1e-9 * np.eye(6)
    fitted = solved(eased, tone.couplings[:, 6:, None])[..., 0]
    weights = np.maximum(tone.weights - np.einsum("mi,mi->m", fitted, tone.couplings[:, 6:]), 0.0)
    slope = tone.slopes - np.einsum("mi,mi->m", fitted, slopes[:, 6:])
    return np.stack((weights, -slope), axis=1)


def allowed_for(tone: Tone, told: Floats, factor: float, information: float) -> tuple[Floats, Floats]:
    """How what is believed of the factor after an image changes what the image says of the poses.

    Args:
        tone: at some poses; told: (m, 2) what each object tells in this image; factor, information: believed before it.

    Returns:
        To be added to the (m, 12, 12) information about twists and to the (m, 12) gradient over them.
    """
    weight, product = told.sum(axis=0)
    change = np.clip(factor + product / (information + weight), 0.0, _MOST_PX) - factor
    known = tone.weights + information
    outer = tone.couplings[:, :, None] * tone.couplings[:, None, :]
    return -outer / known[:, None, None], tone.couplings * change


def remembered(before: Array, told: Floats, factor: float) -> Floats:
    """What an object has told after an image, older images fading.

    Args:
        before: the same before; told: (2,) of `told_by`; factor: that the places of edges were corrected by.
    """
    now = np.array([told[0], told[1] + factor * told[0]])
    kept: Floats = (1.0 - 1.0 / _IMAGES) * np.asarray(before, dtype=np.float64) + now
    return kept
