"""Control points on the edges of objects that a camera is expected to see, and the chance that each one is.

An edge is an outline where all that the object shows beside it lies on one side of it in the image, a crease where
faces on both sides are seen. A smooth surface has its outline where it turns away. What an object hides of itself is
left out. What another may hide is kept with the chance that it does not, given how uncertain both poses are: a mask
that is believed too firmly hides true edges."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.imagery.layers import NEAREST_DRAWN_M, Layer
from hierax.nodes.tracking.math.batched import joined, only
from hierax.nodes.tracking.math.geometry import Array, Floats, Size, cross, invert, project, transform, unit
from hierax.nodes.tracking.model.controls import CREASE, LIMB, OUTLINE, Controls
from hierax.nodes.tracking.model.shapes import Ints, Shape, chained


class _Lines(NamedTuple):
    """Lines (n) to put points on: ends (n, 2, 3), and the rest as in `Controls`."""

    ends: Floats
    inwards: Floats
    kinds: NDArray[np.uint8]
    edges: Ints
    faces: Ints


def controls_of(
    shape: Shape, pose: Floats, intrinsics: Array, size: Size, layer: Layer | None = None, radius_m: float = 0.0
) -> Controls:
    """Points on the edges of an object that would be seen if it were alone: about `SPACING_PX` apart in the image,
    fewer where there would be more than `POINTS_MAX`; all with ``visible`` 1.

    Args: shape: the object; pose: camera_from_object; intrinsics: (4,) fx, fy, cx, cy in pixels; size: width and height
        of the image in pixels. layer: the object drawn alone; needed of a body that is not convex. radius_m: by which
        its convex edges are worn round.
    """
    viewpoint = invert(pose)[:3, 3]
    lines = _sharp_lines(shape, viewpoint, radius_m)
    if len(shape.smooth):
        lines = joined((lines, _smooth_lines(shape, viewpoint)))
    seen = transform(pose, lines.ends)
    ahead = seen[..., 2].min(axis=1, initial=np.inf) > NEAREST_DRAWN_M
    lines = only(lines, ahead)
    pixels = project(seen[ahead], intrinsics)
    outside = (pixels.max(axis=1, initial=-np.inf) < 0.0) | (pixels.min(axis=1, initial=np.inf) > np.array(size))
    lengths = np.where(outside.any(axis=1), 0.0, np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=1))
    owners, shares = _spread(lengths, lines.edges)
    lines = only(lines, owners)  # of each point
    step = lines.ends[:, 1] - lines.ends[:, 0]
    points = lines.ends[:, 0] + shares[:, None] * step
    tangents = step / np.linalg.norm(step, axis=1, keepdims=True)
    controls = Controls(np.zeros(len(points), dtype=np.intp), points, tangents, *lines[1:], np.ones(len(points)))
    spots = project(transform(pose, points), intrinsics)
    inside = (spots > -const.OUTSIDE_PX) & (spots < np.array(size) - 1.0 + const.OUTSIDE_PX)
    kept = np.asarray(inside.all(axis=1))
    if layer is not None and not shape.convex:
        kept &= ~_hidden_by_itself(controls, pose, intrinsics, layer, const.OWN_SHARE * float(np.ptp(shape.vertices)))
    return _numbered(shape, pose, only(controls, kept))


def _sharp_lines(shape: Shape, viewpoint: Floats, radius_m: float) -> _Lines:
    """The sharp edges beside which something faces the camera, where they are seen if they are worn round."""
    corners = shape.vertices[shape.edges[:, :1]]
    facing = np.sum(shape.normals[shape.edge_faces] * (viewpoint - corners), axis=2) > 0.0
    seen = (facing | ~shape.closed[shape.edge_faces]) & (shape.edge_faces >= 0)
    chosen = seen.any(axis=1)
    seen, beside = seen[chosen], shape.edge_faces[chosen]
    ends, inwards = shape.vertices[shape.edges[chosen]], shape.inwards[chosen]
    # On which side of the plane through the camera and the edge each face lies.
    plane = cross(ends[:, 0] - viewpoint, ends[:, 1] - viewpoint)
    sides = np.einsum("ej,esj->es", plane, inwards)
    crease = seen.all(axis=1) & (sides[:, 0] * sides[:, 1] < 0.0)
    ends = ends + radius_m * _worn(shape.normals[beside], inwards, plane, crease)[:, None]
    patches = np.where(seen, shape.patches[beside], -1)
    first = np.where(seen[:, 0], 0, 1)
    rows = np.arange(len(first))
    kinds = np.where(crease, CREASE, OUTLINE).astype(np.uint8)
    faces = np.stack((patches[rows, first], patches[rows, 1 - first]), axis=1)
    return _Lines(ends, inwards[rows, first], kinds, shape.chains[chosen], faces)


def _worn(normals: Floats, inwards: Floats, plane: Floats, crease: NDArray[np.bool_]) -> Floats:
    """(n, 3) how far edges that are worn round lie beside sharp ones, in radii.

    The round edge is a cylinder that touches both faces. Its outline is where its normal is square to the view; as a
    crease it is seen where light changes from one face's to the other's, in its middle.

    Args: normals, inwards: (n, 2, 3) of both faces; plane: (n, 3) square to the plane through camera and edge.
        crease: (n,) whether both faces are seen.
    """
    both = normals.sum(axis=1)
    middle = unit(both)
    outline = unit(plane) * np.sign(np.sum(plane * both, axis=1, keepdims=True))
    touching = np.where(crease[:, None], middle, outline)
    apart = 1.0 + np.sum(normals[:, 0] * normals[:, 1], axis=1, keepdims=True)
    convex = np.sum(normals[:, 0] * inwards[:, 1], axis=1, keepdims=True) < 0.0
    return np.asarray(np.where(convex, touching - both / np.maximum(apart, 0.2), 0.0))


def _smooth_lines(shape: Shape, viewpoint: Floats) -> _Lines:
    """Where smooth surfaces turn away from the camera; each chain has a number of its own, for the time being."""
    found = outline_of(shape, viewpoint)
    patches = shape.patches[shape.smooth[found.smooth]]
    beside = np.stack((patches, np.full_like(patches, -1)), axis=1)
    kinds = np.full(len(patches), LIMB, dtype=np.uint8)
    return _Lines(found.ends, -found.outwards, kinds, _sharp_count(shape) + found.chains, beside)


def _sharp_count(shape: Shape) -> int:
    return int(shape.chains.max(initial=-1)) + 1


def _numbered(shape: Shape, pose: Floats, controls: Controls) -> Controls:
    """Points on smooth outlines numbered by patch and by the direction to which the outline bounds it in the image: so
    much of an outline stays the same from image to image, and is about straight."""
    smooth = controls.edges >= _sharp_count(shape)
    if not smooth.any():
        return controls
    outwards = -controls.inwards @ pose[:2, :3].T
    turn = np.arctan2(outwards[:, 1], outwards[:, 0]) / (2.0 * np.pi)
    sector = np.floor(turn * const.SECTORS + 0.5).astype(np.int32) % const.SECTORS
    patches = np.zeros(int(shape.patches.max()) + 1, dtype=np.int32)
    patches[shape.patches[shape.smooth]] = shape.smooth_patches
    numbers = _sharp_count(shape) + const.SECTORS * patches[controls.faces[:, 0]] + sector
    numbers = np.where(smooth, numbers, controls.edges).astype(np.int32)
    places = np.arange(len(numbers))
    for chain in np.unique(controls.edges[smooth]):
        points = np.nonzero(controls.edges == chain)[0]
        changes = np.nonzero(np.diff(sector[points]))[0]
        # A ring's last points are before its first ones, where one sector holds both.
        if len(changes) and sector[points[0]] == sector[points[-1]]:
            places[points] = points[0] + (np.arange(len(points)) - changes[0] - 1) % len(points)
    order = np.lexsort((places, numbers))
    return only(controls._replace(edges=numbers), order)


def _spread(lengths: Floats, edges: Ints) -> tuple[NDArray[np.intp], Floats]:
    """On which line each point is, and how far along it (0 to 1): evenly along each edge's lines, one after the other;
    lengths: (n,) in pixels, 0 for no points; edges: (n,) numbers of those that the lines are parts of, in runs."""
    starts = np.nonzero(np.diff(edges, prepend=-1))[0]
    if not len(starts):
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    total = np.add.reduceat(lengths, starts)
    spacing = max(const.SPACING_PX, float(total.sum()) / const.POINTS_MAX)
    counts = np.where(
        total < 2.0 * const.CHAIN_END_PX, 0, ((total - 2.0 * const.CHAIN_END_PX) / spacing).astype(int) + 1
    )
    run = np.repeat(np.arange(len(starts)), counts)
    order = np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts)
    before = np.concatenate(([0.0], np.cumsum(lengths)))
    within = const.CHAIN_END_PX + (total - 2.0 * const.CHAIN_END_PX)[run] * (order + 0.5) / counts[run]
    places = before[starts][run] + within
    owners = np.clip(np.searchsorted(before, places, side="right") - 1, 0, len(lengths) - 1)
    shares = (places - before[owners]) / np.maximum(lengths[owners], 1e-9)
    return owners, np.clip(shares, 0.0, 1.0)


def _hidden_by_itself(
    controls: Controls, pose: Floats, intrinsics: Array, layer: Layer, depth_m: float
) -> NDArray[np.bool_]:
    """Whether the object's own surface is in front of each point.

    Just outside an outline that is seen there is nothing of the object, or something farther away; beside a crease,
    on one side at least, nothing that is nearer. What is hidden by the width of a pixel is hidden: an edge that is
    taken for seen there would claim the outline of what hides it."""
    seen = transform(pose, controls.points)
    inwards = _across(controls, seen, pose, intrinsics)
    middle = project(seen, intrinsics) - layer.window.corner
    width, height = layer.window.size
    hidden = np.ones(len(seen), dtype=bool)
    for side in (-const.OWN_BESIDE_PX, const.OWN_BESIDE_PX):
        at = np.rint(middle + side * inwards).astype(np.intp)
        inside = ((at >= 0) & (at < (width, height))).all(axis=1)
        columns, rows = np.clip(at, 0, (width - 1, height - 1)).T
        there = np.where(inside, layer.inverse[rows, columns], 0.0)
        nearer = (there > 0.0) & ((seen[:, 2] - depth_m) * there > 1.0)
        hidden &= nearer | ((side > 0.0) & (controls.kinds != CREASE))
    return hidden


def _across(controls: Controls, seen: Floats, pose: Floats, intrinsics: Array) -> Floats:
    """(n, 2) unit vectors in the image, square to the edge, to the side of `Controls.inwards`."""
    flat = seen[:, :2] / seen[:, 2:]

    def moved(directions: Floats) -> Floats:
        turned = directions @ pose[:3, :3].T
        return np.asarray(intrinsics[:2] * (turned[:, :2] - flat * turned[:, 2:]))

    along, inward = moved(controls.tangents), moved(controls.inwards)
    normals = np.stack((-along[:, 1], along[:, 0]), axis=1)
    normals *= np.where(np.sum(normals * inward, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


class Outline(NamedTuple):
    """Pieces (n) of the lines at which a surface's normal is at right angles to the ray, object's frame."""

    ends: Floats  # (n, 2, 3) metres; each begins where the one before it in its chain ended
    outwards: Floats  # (n, 3) unit normals of the surface
    smooth: NDArray[np.intp]  # (n,) places in `Shape.smooth` of the faces that they cross
    chains: Ints  # (n,) number of the chain, from 0, rising


def outline_of(shape: Shape, viewpoint: Floats) -> Outline:
    """The outline of a shape's smooth surfaces, hidden or not, from the camera's centre (3,) in the object's frame."""
    towards = np.sum(shape.corner_normals * (viewpoint - shape.corners), axis=1)
    one, two, three = (towards > 0.0)[shape.smooth_corners].T
    smooth = np.nonzero((one != two) | (two != three))[0]
    places = shape.smooth_corners[smooth]
    # The one corner that faces the other way than both others; the line crosses the two sides from it.
    ahead = towards[places] > 0.0
    alone = np.where(ahead.sum(axis=1) == 1, ahead.argmax(axis=1), ahead.argmin(axis=1))
    rows = np.arange(len(alone))
    apex = places[rows, alone][:, None]
    others = np.stack((places[rows, (alone + 1) % 3], places[rows, (alone + 2) % 3]), axis=1)
    share = (towards[apex] / (towards[apex] - towards[others]))[..., None]
    ends = shape.corners[apex] + share * (shape.corners[others] - shape.corners[apex])
    normals = shape.corner_normals[apex] + share * (shape.corner_normals[others] - shape.corner_normals[apex])
    outwards = unit(normals.sum(axis=1))
    crossed = np.minimum(apex, others).astype(np.int64) * len(shape.corners) + np.maximum(apex, others)
    order, turned, chains = chained(_beyond(crossed), 0)
    ends = np.where(turned[:, None, None], ends[order, ::-1], ends[order])
    return Outline(ends, outwards[order], smooth[order], chains)


def _beyond(crossed: NDArray[np.int64]) -> NDArray[np.intp]:
    """The ends that meet, as `chained` takes them, by the side of a triangle on which each begins and ends, (n, 2)."""
    sides = crossed.ravel()
    order = np.argsort(sides, kind="stable")
    meeting = np.nonzero(sides[order][1:] == sides[order][:-1])[0]
    beyond = np.full(len(sides), -1)
    beyond[order[meeting]], beyond[order[meeting + 1]] = order[meeting + 1], order[meeting]
    return beyond
