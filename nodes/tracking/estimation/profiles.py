"""What the image shows across the expected edges of all objects: grey profiles along the normals, and their peaks."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.math.batched import placed
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats
from hierax.nodes.tracking.model.controls import Controls, Indices

Image = NDArray[np.float32]
Singles = NDArray[np.float32]


class Lines(NamedTuple):
    """Control points as some poses show them."""

    rows: Indices  # (n,) which of the controls are in the image
    pixels: Floats  # (n, 2)
    normals: Floats  # (n, 2) unit, across the edge, into the face of `inwards`


class Profiles(NamedTuple):
    """Profiles along the normals."""

    places: Singles  # (n, k) pixels along the normal of each peak of the gradient, inf where there is none
    sharpness: Singles  # (n, k) curvature over height, 1/px²: what a blurred step has more of than a shadow
    inside: Singles  # inside, outside: (n, k, channels) colours beside each place
    outside: Singles


def smoothed(image: Array) -> Image:
    """The image that is searched: light, float32 (h, w, channels), 0 to 255, lightly smoothed, of an image, uint8,
    (h, w) gray or (h, w, 3) RGB, that is encoded as cameras do."""
    soft = np.asarray(cv2.GaussianBlur(light_of(image), (5, 5), 0.9), dtype=np.float32)
    return soft[:, :, None] if soft.ndim == 2 else soft


def light_of(image: Array) -> Image:
    """The light of a picture, 0 to 255, which is encoded as cameras do: uint8 of any shape."""
    return np.asarray(cv2.LUT(image, const.LIGHT), dtype=np.float32)


def grey_levels(light: Array) -> Singles:
    """Light as grey levels, 0 to 255, in which noise and contrast are alike in dark and bright."""
    return np.asarray(np.sqrt(np.float32(255.0) * light), dtype=np.float32)


def lines_of(controls: Controls, poses: Floats, intrinsics: Array, shape: tuple[int, ...]) -> Lines:
    """Where the poses (m, 4, 4) put the controls, those that are in an image of this shape."""
    rotations = poses[controls.owners, :3, :3]
    middle = placed(poses, controls.owners, controls.points)
    along = (rotations @ controls.tangents[:, :, None])[..., 0]
    inward = (rotations @ controls.inwards[:, :, None])[..., 0]
    depth = np.maximum(middle[:, 2], NEAREST_M)
    focal = np.asarray(intrinsics[:2], dtype=np.float64)
    flat = middle[:, :2] / depth[:, None]
    pixels = focal * flat + intrinsics[2:]
    direction = focal * (along[:, :2] - flat * along[:, 2:]) / depth[:, None]
    length = np.sqrt(np.einsum("nk,nk->n", direction, direction))
    direction = direction / np.maximum(length, 1e-9)[:, None]
    normals = np.stack((-direction[:, 1], direction[:, 0]), axis=1)
    side = np.einsum("nk,nk->n", normals, focal * (inward[:, :2] - flat * inward[:, 2:]))
    normals = np.where(side[:, None] < 0, -normals, normals)
    high, wide = shape[:2]
    inside = (pixels > const.IMAGE_MARGIN_PX).all(axis=1) & (
        pixels < (wide - const.IMAGE_MARGIN_PX, high - const.IMAGE_MARGIN_PX)
    ).all(axis=1)
    # Seen along their length, edges have no direction across.
    inside &= (middle[:, 2] > NEAREST_M) & (length * const.ALONG_M > 0.02)
    rows = np.nonzero(inside)[0]
    return Lines(rows, pixels[rows], normals[rows])


def read_profiles(image: Image, lines: Lines, edges: Indices, reach: int, contrast: float) -> Profiles:
    """The profiles to `reach` pixels on both sides, and all extremes of their gradients.

    A profile is averaged with its neighbours on the edge: noise falls, the edge stays. Peaks are told in grey levels,
    their places in light. Of the lines the rows are ascending, so that neighbours on an edge (n,) stand together;
    contrast: smallest slope that counts as an edge, grey levels per pixel."""
    half = reach + 1 + const.BESIDE_PX[-1]
    offsets = np.arange(-half, half + 1, dtype=np.float32)
    pixels, normals = lines.pixels.astype(np.float32), lines.normals.astype(np.float32)
    across = pixels[:, None, 0] + offsets * normals[:, None, 0]
    down = pixels[:, None, 1] + offsets * normals[:, None, 1]
    values = _sampled(image, across, down)
    light = _along_edges(values.reshape(*across.shape, -1), edges)
    values = grey_levels(light)
    slope = 0.5 * (values[:, 2:] - values[:, :-2])
    begin = const.BESIDE_PX[-1] - 1
    slope = slope[:, begin : begin + 2 * reach + 3]
    size = np.sqrt(np.einsum("pkc,pkc->pk", slope, slope))
    # Neighbours on the other flank of a thin line slope the other way: they do not shape this peak.
    agree = np.einsum("pkc,pkc->pk", slope[:, 1:], slope[:, :-1]) > 0
    middle = size[:, 1:-1]
    before = np.where(agree[:, :-1], size[:, :-2], np.float32(0.0))
    after = np.where(agree[:, 1:], size[:, 2:], np.float32(0.0))
    top = (middle > contrast) & (middle >= before) & (middle > after)
    bend = np.where(top, 2.0 * middle - before - after, np.float32(1.0))
    near = np.arange(-reach, reach + 1, dtype=np.float32)
    shift = _shift(light[:, begin : begin + 2 * reach + 5], top)
    places: Singles = np.where(top, near + shift, np.float32(np.inf))
    sharpness = np.where(top, bend / np.maximum(middle, contrast), np.float32(0.0))
    inside, outside = (_beside(values, half, reach, side) for side in (1, -1))
    return Profiles(places, sharpness, inside, outside)


def _shift(light: Singles, top: NDArray[np.bool_]) -> Singles:
    """How far from each peak of the encoded slope light itself is steepest, pixels."""
    shift = np.zeros(top.shape, dtype=np.float32)
    rows, at = np.nonzero(top)
    around = np.arange(-3, 4)
    columns = np.clip(at[:, None] + 2 + around, 0, light.shape[1] - 1)
    local = light[rows[:, None], columns]
    slope = local[:, 2:] - local[:, :-2]
    size = np.sqrt(np.einsum("nkc,nkc->nk", slope, slope))  # of -2 to 2
    steepest = 1 + size[:, 1:4].argmax(axis=1)
    every = np.arange(len(rows))
    here, before, after = size[every, steepest], size[every, steepest - 1], size[every, steepest + 1]
    bend = 2.0 * here - before - after
    part = np.where(bend > 0, 0.5 * (after - before) / np.where(bend > 0, bend, 1.0), 0.0)
    shift[rows, at] = steepest - 2 + np.clip(part, -0.5, 0.5)
    return shift


def _sampled(image: Image, across: Singles, down: Singles) -> Singles:
    """The image at places, row by row; OpenCV takes less than 32768 rows at a time."""
    starts = range(0, max(1, len(across)), const.MOST_ROWS)
    places = [(across[start : start + const.MOST_ROWS], down[start : start + const.MOST_ROWS]) for start in starts]
    parts = [cv2.remap(image, *each, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for each in places]
    return np.asarray(np.concatenate(parts), dtype=np.float32)


def _beside(values: Singles, half: int, reach: int, side: int) -> Singles:
    """(n, k, channels): the mean of the profiles a little to one side of each place."""
    starts = [half - reach + side * step for step in const.BESIDE_PX]
    total: Singles = values[:, starts[0] : starts[0] + 2 * reach + 1].copy()
    for start in starts[1:]:
        total += values[:, start : start + 2 * reach + 1]
    total *= np.float32(1.0 / len(starts))
    return total


def _along_edges(values: Singles, edges: Indices) -> Singles:
    """Each profile averaged with those before and behind it on its edge, 1 : 2 : 1."""
    if len(values) < 2:
        return values
    same = (edges[1:] == edges[:-1])[:, None, None]
    before, after = values.copy(), values.copy()
    before[1:] = np.where(same, values[:-1], values[1:])
    after[:-1] = np.where(same, values[1:], values[:-1])
    total: Singles = before + after + values + values
    total *= np.float32(0.25)
    return total
