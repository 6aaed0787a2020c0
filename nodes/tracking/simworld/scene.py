"""Pictures of bodies on a table, by exact projection: no part of it is shared with the mental image of the nodes.

The faces of the bodies are planes, and drawn as such: where they are seen at four samples a pixel, with the light of
the pixel's middle. Curved ones are drawn as meshes, with the light that their smoothed normals have of it: shadows do
not fall on them, but they throw some."""

from collections.abc import Sequence
from functools import lru_cache
from math import prod
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, Size
from hierax.nodes.tracking.simworld.light import LAMP, Lamp, Window, shaded
from hierax.nodes.tracking.simworld.raster import Drawn, drawn, homography
from hierax.nodes.tracking.simworld.shapes import Face, Thing

SAMPLES = 2  # per pixel, along each axis
TABLE_M = (1.5, 1.3)
TABLE_PX_PER_M = 800
TABLE_RIM_PX = 6
FACE_PX = 96
TEXELS = np.array([[FACE_PX, 0.0, -0.5], [0.0, FACE_PX, -0.5], [0.0, 0.0, 1.0]])  # from a face's coordinates
# From (column, row, 1) of a pixel in a window to that of its middle among the samples.
_MIDDLES = np.array([[SAMPLES, 0.0, (SAMPLES - 1) / 2], [0.0, SAMPLES, (SAMPLES - 1) / 2], [0.0, 0.0, 1.0]])
QUANTILES = 1 << 8
GAMMA = 2.2  # a picture holds about this root of light
_LIGHT = ((np.arange(256) / 255.0) ** GAMMA).astype(np.float32)


class Wood(NamedTuple):
    """How the table looks."""

    colour: tuple[int, int, int] = (168, 134, 98)  # RGB, 0 to 255
    unevenness: float = 1.0  # how strong grain and planks are; 1 is that of a plain table
    seed: int = 7  # which grain
    tile_m: float = 0.0  # side of the squares, light and dark by turns, with which it is laid; 0 for planks


WOOD = Wood()


def draw(
    bodies: Sequence[Thing], camera: Floats, intrinsics: Array, size: Size, lamp: Lamp = LAMP, wood: Wood = WOOD
) -> Array:
    """The light of the picture, RGB float32 (h, w, 3), 0 to 1, before a lens blurs and a sensor encodes it; colours and
    lamps are told as a screen shows them. Bodies are above the plane z = 0 and in front of the camera
    (world_from_camera), which is above that plane, too; intrinsics are fx, fy, cx, cy in pixels, size is (width,
    height)."""
    parts = [corners for body in bodies for corners in body.parts()]
    image = _draw_table(parts, camera, intrinsics, size, lamp, wood)
    _draw_bodies(image, bodies, parts, camera, intrinsics, lamp)
    return image


def develop(image: Array, blur_px: float, noise: float, rng: np.random.Generator) -> Array:
    """What a sensor makes of the light of a picture, RGB uint8, encoded as screens want it; blur of the lens in pixels,
    noise of the sensor in grey levels of 256, both standard deviations."""
    image = cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px > 0.0 else image.copy()
    image = cv2.pow(np.clip(image, 0.0, 1.0, out=image), 1.0 / GAMMA)
    grain = cv2.LUT(drawn_quantiles(rng, image.shape), _normal()) if noise > 0.0 else image
    return np.asarray(cv2.addWeighted(image, 255.0, grain, noise, 0.0, dtype=cv2.CV_8U))


def drawn_quantiles(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Numbers below `QUANTILES`, all equally probable, uint8: those that `rng.integers` draws of a fresh 64-bit
    generator, in less than half of the time."""
    count = prod(shape)
    drawn = np.asarray(rng.bit_generator.random_raw(-(-count // 8)), "<u8")  # one number by eight, the lowest first
    return np.asarray(drawn.view(np.uint8)[:count].reshape(shape))


@lru_cache(maxsize=1)
def _normal() -> Array:
    """The normal distribution, as `QUANTILES` equally probable numbers, float32: drawing one of them takes a tenth of
    the time of drawing from the distribution itself."""
    steps = np.linspace(-6.0, 6.0, 1 << 16)
    below = np.cumsum(np.exp(-0.5 * steps**2))
    middles = (np.arange(QUANTILES) + 0.5) / QUANTILES
    numbers = np.interp(middles, below / below[-1], steps)
    return np.asarray(numbers / numbers.std(), dtype=np.float32)


def _draw_table(
    parts: Sequence[Floats], camera: Floats, intrinsics: Array, size: Size, lamp: Lamp, wood: Wood
) -> Array:
    """The table with its shadows, over a wall that gets darker downwards."""
    width, height = TABLE_M
    table = Face(np.array([-width / 2, -height / 2, 0.0]), np.array([width, 0.0, 0.0]), np.array([0.0, height, 0.0]))
    to_pixels = homography(table, camera, intrinsics)
    planks = _planks(wood)
    texels = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    texels = np.diag([1.0 / planks.shape[1], 1.0 / planks.shape[0], 1.0]) @ texels
    picture = _wall(size).copy()
    cv2.warpPerspective(planks, to_pixels @ texels, size, picture, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    bright, (left, top, right, bottom), shade = shaded(table, parts, size, to_pixels, lamp)
    lit: Array = cv2.LUT(picture, _LIGHT * np.float32(bright**GAMMA))
    if shade.size:
        _dim(lit[top:bottom, left:right], cv2.pow(shade / np.float32(bright), GAMMA))
    return lit


def _draw_bodies(
    image: Array, bodies: Sequence[Thing], parts: Sequence[Floats], camera: Floats, intrinsics: Array, lamp: Lamp
) -> None:
    """Put the bodies into the picture: what is seen of a side at `SAMPLES` x `SAMPLES` per pixel, and its light at each
    pixel's middle."""
    view = (camera, intrinsics, (image.shape[1], image.shape[0]), SAMPLES)
    every = [(side, body.colour) for body in bodies for side in drawn(body, *view)]
    if not every:
        return
    left, top = (min(side.window[at] for side, _ in every) for at in (0, 1))
    right, bottom = (max(side.window[at] for side, _ in every) for at in (2, 3))
    owners = _owners([side for side, _ in every], (left, top, right, bottom))
    _dim(image[top:bottom, left:right], _mean(owners == 0))
    for number, (side, colour) in enumerate(every, start=1):
        seen = owners[_samples_of(side, left, top)] == number
        if seen.any():
            left_px, top_px, right_px, bottom_px = side.window
            image[top_px:bottom_px, left_px:right_px] += _light_of(side, seen, colour, parts, lamp)


def _owners(sides: Sequence[Drawn], window: Window) -> Array:
    """Of each sample in a window of pixels the number of the side that is nearest there, from 1 on; 0 for none; of two
    that are equally near the first."""
    left, top, right, bottom = window
    shape = ((bottom - top) * SAMPLES, (right - left) * SAMPLES)
    nearest, owners = np.zeros(shape, np.float32), np.zeros(shape, np.uint16)
    for number, side in enumerate(sides, start=1):
        place = _samples_of(side, left, top)
        nearer = cv2.compare(side.nearness, nearest[place], cv2.CMP_GT)
        cv2.copyTo(side.nearness, nearer, nearest[place])
        cv2.copyTo(np.full(nearer.shape, number, np.uint16), nearer, owners[place])
    return owners


def _samples_of(side: Drawn, left: int, top: int) -> tuple[slice, slice]:
    """Where a side's samples are among those of a window that begins at a pixel."""
    own = [(each - origin) * SAMPLES for each, origin in zip(side.window, (left, top, left, top), strict=True)]
    return slice(own[1], own[3]), slice(own[0], own[2])


def _mean(samples: Array) -> Array:
    """The mean over the samples of each pixel, float32."""
    size = (samples.shape[1] // SAMPLES, samples.shape[0] // SAMPLES)
    return np.asarray(cv2.resize(samples.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _dim(image: Array, share: Array) -> None:
    """Multiply all channels of a part of a picture (h, w, 3) by a share (h, w), in place."""
    cv2.multiply(image, cv2.merge((share, share, share)), dst=image)


def _light_of(side: Drawn, seen: Array, colour: tuple[int, int, int], parts: Sequence[Floats], lamp: Lamp) -> Array:
    """The light that comes to the pixels of a side's window from its samples that are seen, float32 (h, w, 3)."""
    if side.face is None:
        light = lamp.ambient + lamp.diffuse * np.maximum(side.at @ lamp.direction.astype(np.float32), 0.0)
        return _mean(np.minimum(_paint(colour) * cv2.pow(light, GAMMA)[..., None], 1.0) * seen[..., None])
    share = _mean(seen)
    texture = _lit_texture(side.face, colour, parts, lamp)
    to_texels, how = TEXELS @ side.at @ _MIDDLES, cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    coloured = cv2.warpPerspective(texture, to_texels, share.shape[::-1], None, how, cv2.BORDER_REPLICATE)
    _dim(coloured, share)
    return np.asarray(coloured)


def _lit_texture(face: Face, colour: tuple[int, int, int], parts: Sequence[Floats], lamp: Lamp) -> Array:
    """The light of each point of a face, float32 (FACE_PX, FACE_PX, 3)."""
    bright, (left, top, right, bottom), shade = shaded(face, parts, (FACE_PX, FACE_PX), TEXELS, lamp)
    texture = _painted(colour) * np.float32(bright**GAMMA)
    if shade.size:
        _dim(texture[top:bottom, left:right], cv2.pow(shade / np.float32(bright), GAMMA))
    return np.asarray(np.minimum(texture, np.float32(1.0), out=texture))


@lru_cache(maxsize=64)
def _painted(colour: tuple[int, int, int]) -> Array:
    """What a painted face throws back of white light, float32 (FACE_PX, FACE_PX, 3)."""
    return np.asarray(cv2.pow(_grain(), GAMMA)[..., None] * _paint(colour))


def _paint(colour: tuple[int, int, int]) -> Array:
    """What of white light a colour throws back, float32 (3,)."""
    return np.asarray((np.array(colour, np.float32) / np.float32(255.0)) ** np.float32(GAMMA))


@lru_cache(maxsize=1)
def _grain() -> Array:
    """Faint unevenness of painted wood, about 1."""
    noise = np.random.default_rng(11).standard_normal((FACE_PX, FACE_PX)).astype(np.float32)
    streaks = cv2.GaussianBlur(noise, (0, 0), sigmaX=9.0, sigmaY=0.8)
    return np.asarray(1.0 + 0.02 * streaks / streaks.std(), dtype=np.float32)


@lru_cache(maxsize=4)
def _wall(size: Size) -> Array:
    """What is behind the table, uint8 RGB, before the light is taken into account."""
    grey = np.linspace(86.0, 43.0, size[1], dtype=np.float32)[:, None, None] * np.array([0.96, 1.0, 1.06], np.float32)
    return np.asarray(np.repeat(grey.astype(np.uint8), size[0], axis=1))


@lru_cache(maxsize=4)
def _planks(wood: Wood) -> Array:
    """The table's top of planks or tiles, RGB uint8, with a dark rim."""
    columns, rows = (round(length * TABLE_PX_PER_M) for length in TABLE_M)
    rng = np.random.default_rng(wood.seed)
    grain = 0.035 * _streaks(rng, (rows, columns), 4) + 0.05 * _streaks(rng, (rows, columns), 24)
    tone = 1.0 + np.float32(wood.unevenness) * grain
    if wood.tile_m > 0.0:
        places = [np.arange(count) // round(wood.tile_m * TABLE_PX_PER_M) for count in (rows, columns)]
        dark = (places[0][:, None] + places[1][None, :]) % 2
        tone *= 1.0 - np.float32(0.3 * wood.unevenness) * dark.astype(np.float32)
    plank_px = rows // 8
    for index in range(0, rows if wood.tile_m == 0.0 else 0, plank_px):
        tone[index : index + plank_px] *= 1.0 + wood.unevenness * (rng.uniform(0.93, 1.06) - 1.0)
        tone[index : index + 2] *= 1.0 - 0.28 * wood.unevenness
    planks: Array = np.clip(tone[..., None] * np.array(wood.colour, np.float32), 0, 220).astype(np.uint8)
    for edge in (planks[:TABLE_RIM_PX], planks[-TABLE_RIM_PX:], planks[:, :TABLE_RIM_PX], planks[:, -TABLE_RIM_PX:]):
        edge[:] = (edge * 0.55).astype(np.uint8)
    return planks


def _streaks(rng: np.random.Generator, shape: tuple[int, int], width_px: int) -> Array:
    """Smooth unevenness of deviation 1 that runs along the rows, float32."""
    rows, columns = shape
    coarse = (rows // width_px + 2, columns // (width_px * 12) + 2)
    noise = rng.standard_normal(coarse).astype(np.float32)
    smooth: Array = cv2.resize(noise, (columns, rows), interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth / smooth.std())
