"""Letters in a picture: the likelihoods of `hierax.nodes.letters` come from pixels.

A sign is drawn by someone whose hand is not exact: of an H the uprights may lean together, by an amount a between 0 (an
H as it should be) and 1 (an A), with density 2(1 - a); of an A, with density 2a. A camera adds Gaussian noise. So

    p(pixels | H) = ∫ N(pixels; drawn(a), σ²) 2(1 - a) da

and likewise of A. With the two ideal templates alone, the noise in the pixels would decide how a sign halfway between
them is read, and with full confidence."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hierax.nodes.letters.tree import LetterNode, Weights, is_number
from hierax.runtime import NO_TICK, Elements, Probe, Step, Tick, Value, World
from hierax.runtime.core.showing import Image, Things

cv2.setNumThreads(1)  # equal pixels in every run, and no threads in the nodes' processes

PAPER = 200  # grey value of the ground; far enough from 255 for noise to stay Gaussian
INK = 56  # grey value of the strokes
AMBIGUOUS = "?"  # the sign between H and A
GREYS = np.dtype(np.uint8)

Picture = np.ndarray[Any, np.dtype[np.uint8]]

_FRACTION_BITS = 6
_BOW = [(0.54 + 0.34 * math.cos(math.radians(a)), 0.5 + 0.35 * math.sin(math.radians(a))) for a in range(45, 316, 15)]
_CORNERS: Mapping[str, list[list[tuple[float, float]]]] = {
    "A": [[(0.22, 0.86), (0.5, 0.14)], [(0.78, 0.86), (0.5, 0.14)], [(0.36, 0.5), (0.64, 0.5)]],
    "C": [_BOW],
    "E": [[(0.72, 0.14), (0.3, 0.14), (0.3, 0.86), (0.72, 0.86)], [(0.3, 0.5), (0.66, 0.5)]],
    "H": [[(0.22, 0.86), (0.22, 0.14)], [(0.78, 0.86), (0.78, 0.14)], [(0.22, 0.5), (0.78, 0.5)]],
    "T": [[(0.2, 0.16), (0.8, 0.16)], [(0.5, 0.16), (0.5, 0.86)]],
}
# Each letter's strokes, (n, 2) in a unit square, x to the right and y down. H and A have the same, in other places.
_STROKES = {letter: [np.array(stroke) for stroke in strokes] for letter, strokes in _CORNERS.items()}

DRAWN = tuple(_STROKES)  # the letters that can be drawn


MIN_SIZE = 12
MAX_SIZE = 256
LEANINGS = tuple(step / 20 for step in range(21))  # the values of a at which the integral is summed
Templates = tuple[np.ndarray[Any, np.dtype[np.int32]], tuple[float, ...]]


@lru_cache(maxsize=256)
def draw_glyph(sign: str, ambiguity: float, size: int) -> Picture:
    """A sign as grey values, shape (size, size), uint8, read-only; `AMBIGUOUS` is so far on the way from H (0) to A:
    the uprights lean together."""
    picture = np.full((size, size), PAPER, GREYS)
    scale = size * (1 << _FRACTION_BITS)
    h_to_a = zip(_STROKES["H"], _STROKES["A"], strict=True)
    leaning = [(1.0 - ambiguity) * h + ambiguity * a for h, a in h_to_a]
    for stroke in leaning if sign == AMBIGUOUS else _STROKES[sign]:
        points = np.rint(stroke * scale).astype(np.int32)
        cv2.polylines(picture, [points], False, INK, max(1, size // 10), cv2.LINE_AA, _FRACTION_BITS)
    picture.flags.writeable = False
    return picture


def draw_picture(letters: str, ambiguity: float, size: int) -> Picture:
    """Signs in a row, shape (size, size × their number), uint8."""
    return np.hstack([draw_glyph(sign, ambiguity, size) for sign in letters])


class PictureWorld(World):
    """N₀: signs drawn in a row, each of A, C, E, H, T or ``?``, which is so far on the way from H (0) to A (1). Belief:
    ``{"letters": …, "ambiguity": …}``; the picture follows from it and is not kept. Raises ValueError: a sign is
    unknown, or the ambiguity is not from 0 to 1."""

    def __init__(self, letters: str, ambiguity: float = 0.5) -> None:
        known = (*DRAWN, AMBIGUOUS)
        if not isinstance(letters, str) or not letters or any(sign not in known for sign in letters):
            raise ValueError(f"letters: expected signs out of {', '.join(known)}, got {letters!r}")
        if not is_number(ambiguity) or not 0 <= ambiguity <= 1:
            raise ValueError(f"ambiguity: expected a number from 0 to 1, got {ambiguity!r}")
        self._belief = {"letters": letters, "ambiguity": float(ambiguity)}

    def initial_belief(self) -> Value:
        """What is drawn; it stays."""
        return self._belief


class GlyphCamera:
    """φ from the world to a letter node: a camera that looks at one sign, from 1, of so many pixels' height and width;
    noise: standard deviation of the sensor's, in grey values. Raises ValueError: noise or size are out of range."""

    def __init__(self, letter: int, noise: float, size: int = 32) -> None:
        if not is_number(noise) or noise < 0:
            raise ValueError(f"noise: expected a number of grey values, at least 0, got {noise!r}")
        if not isinstance(size, int) or not MIN_SIZE <= size <= MAX_SIZE:
            raise ValueError(f"size: expected a whole number of pixels from {MIN_SIZE} to {MAX_SIZE}, got {size!r}")
        if not isinstance(letter, int) or letter < 1:
            raise ValueError(f"letter: expected a place from 1, got {letter!r}")
        self._letter, self._noise, self._size = letter, float(noise), size

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        """One observation: the sign's part of the picture, shape (size, size), uint8, with fresh noise. Raises
        ValueError: fewer signs are drawn."""
        signs = belief["letters"]
        if self._letter > len(signs):
            raise ValueError(f"letter: there is no sign {self._letter} in {signs!r}")
        left = (self._letter - 1) * self._size
        clean = draw_picture(signs, belief["ambiguity"], self._size)[:, left : left + self._size]
        seen = clean + tick.rng.normal(0.0, self._noise, clean.shape)
        return (np.clip(np.rint(seen), 0, 255).astype(GREYS),)


class PixelLetterNode(LetterNode):
    """A letter node that sees pixels.

    Args:
        words: the vocabulary; letter: the place, from 1.
        sigma: standard deviation of the sensor's noise as the node believes it, in grey values.
        slip: probability that any letter at all was drawn in place of the one that was meant; it keeps the pixels from
            ever ruling a letter out.

    Raises ValueError: a letter of the words cannot be drawn, or a number is out of range."""

    def __init__(self, words: Sequence[str], letter: int, sigma: float, slip: float = 1e-6) -> None:
        super().__init__(words, letter)
        unknown = [name for name in self.names if name not in DRAWN]
        if unknown:
            raise ValueError(f"words: no glyph for {', '.join(unknown)}; there are {', '.join(DRAWN)}")
        if not is_number(sigma) or sigma <= 0:
            raise ValueError(f"sigma: expected a number of grey values above 0, got {sigma!r}")
        if not is_number(slip) or not 0 < slip < 1:
            raise ValueError(f"slip: expected a probability between 0 and 1, got {slip!r}")
        self._sigma, self._slip = float(sigma), float(slip)

    def likelihood(self, observation: Value) -> Weights:
        """p(pixels | letter) by letter, scaled to sum 1, of a square of grey values, uint8. Raises ValueError: it is
        none."""
        is_array = isinstance(observation, np.ndarray) and observation.dtype == GREYS and observation.ndim == 2
        if not is_array or observation.shape[0] != observation.shape[1] or not observation.size:
            what = f"{observation.dtype} of shape {observation.shape}" if is_array else type(observation).__name__
            raise ValueError(f"expected a square of pixels, uint8, got {what}")
        logs = {name: self._log_likelihood(name, observation) for name in self.names}
        top = max(logs.values())
        shares = {name: math.exp(value - top) for name, value in logs.items()}
        total = math.fsum(shares.values())
        even = self._slip / len(shares)
        return {name: (1.0 - self._slip) * share / total + even for name, share in shares.items()}

    def show(self, step: Step, before: Value) -> Things:
        """The sign that was seen, and the posterior, by letter."""
        sign = {"sign/seen": Image(step.observations[0])} if step.observations else {}
        return {**sign, **super().show(step, before)}

    def _log_likelihood(self, name: str, pixels: Picture) -> float:
        """The logarithm of p(pixels | letter), up to a constant."""
        templates, priors = _templates(name, pixels.shape[0])
        # whole numbers: signs at the same distance come out equal to the bit
        squares = ((templates - pixels.astype(np.int32)) ** 2).sum(axis=(1, 2), dtype=np.int64)
        pairs = zip(priors, squares, strict=True)
        logs = [math.log(prior) - int(square) / (2.0 * self._sigma**2) for prior, square in pairs]
        top = max(logs)
        return top + math.log(math.fsum(math.exp(value - top) for value in logs))


class SignPicture(Probe):
    """Writes what a letter node saw last, enlarged by a whole factor, as a picture, such as ``letter1.png``, into the
    run's output folder."""

    def __init__(self, file: str, enlarge: int = 6) -> None:
        self._name, self._enlarge = file, enlarge
        self._file: Path | None = None
        self._seen: Picture | None = None

    def open(self, output: Path | None) -> None:
        """Without an output folder nothing is written."""
        self._file = None if output is None else output / self._name

    def record(self, step: Step) -> None:
        """Remember what was seen."""
        if step.observations:
            self._seen = step.observations[0]

    def close(self) -> None:
        """Write the file. Raises OSError: it cannot be written."""
        if self._file is None or self._seen is None:
            return
        large = np.kron(self._seen, np.ones((self._enlarge, self._enlarge), GREYS))
        encoded = cv2.imencode(".png", large)[1]
        self._file.write_bytes(encoded.tobytes())


@lru_cache(maxsize=64)
def _templates(name: str, size: int) -> Templates:
    """The shapes that a letter may have, (n, size, size), and how likely each is, up to a factor common to letters."""
    if name not in ("H", "A"):
        return draw_glyph(name, 0.0, size).astype(np.int32)[None], (1.0,)
    leanings = {a: prior for a in LEANINGS if (prior := 1.0 - a if name == "H" else a) > 0}
    total = math.fsum(leanings.values())
    shapes = np.stack([draw_glyph(AMBIGUOUS, a, size) for a in leanings]).astype(np.int32)
    return shapes, tuple(prior / total for prior in leanings.values())
