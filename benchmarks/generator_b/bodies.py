"""Bodies: what a tracker is told of them, the nominal model, and what they are, with worn edges and other flaws.

All are an outline with a height, some narrower at the top. The real one's sides may stand elsewhere than the model's,
its edges are rounded, a corner may be broken off. The frame of a body is that of its model where that fits best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, exp_se3
from hierax.nodes.tracking.model.mesh import Mesh

_ARC = 4  # points of a rounded corner


@dataclass(frozen=True)
class Form:
    """A solid: its outline, counter-clockwise in x and y, between two heights."""

    outline: Floats  # (n, 2) metres
    low: float  # low, high: metres
    high: float
    top: float  # how much smaller the outline is at the top
    parts: Sequence[Sequence[int]]  # convex pieces of the outline, by its corners

    def corners(self) -> Floats:
        """(2 n, 3): the lower outline, then the upper one."""
        below = np.column_stack((self.outline, np.full(len(self.outline), self.low)))
        return np.concatenate((below, np.column_stack((self.top * self.outline, np.full(len(below), self.high)))))

    def mesh(self) -> Mesh:
        """Its surface, with sharp edges."""
        return _lofted(self.corners(), self.parts)

    def pieces(self) -> list[Floats]:
        """The corners of convex solids that together are this one."""
        corners, count = self.corners(), len(self.outline)
        return [corners[np.concatenate((part, np.array(part) + count))] for part in self.parts]


@dataclass(frozen=True)
class Body:
    """A model and the thing that it is a model of, in one frame."""

    model: Form  # what the tracker is given
    real: Form  # real, rounded: what the camera sees; `real` without its rounded edges
    rounded: Mesh
    model_pose: Floats  # body_from_model: where the model fits the real one best


def form(
    outline: Sequence[Sequence[float]], height: float, parts: Sequence[Sequence[int]] = (), top: float = 1
) -> Form:
    """A form with the middle of its box at the origin."""
    corners = np.array(outline, dtype=np.float64)
    corners -= (corners.min(axis=0) + corners.max(axis=0)) / 2
    return Form(corners, -height / 2, height / 2, top, parts or [range(len(corners))])


def box(sides: Sequence[float]) -> Form:
    """A box."""
    x, y, z = sides
    return form([(0, 0), (x, 0), (x, y), (0, y)], z)


def random_form(rng: np.random.Generator) -> Form:
    """A box, a corner piece, a bridge, a house, a sloped block or a stump."""
    width, depth, height = rng.uniform((0.05, 0.04, 0.035), (0.095, 0.07, 0.08))
    thick = rng.uniform(0.3, 0.45) * depth
    family = rng.choice(["box", "box", "corner", "bridge", "house", "slope", "stump"])
    if family == "corner":
        outline = [(0, 0), (width, 0), (width, thick), (thick, thick), (thick, depth), (0, depth)]
        return form(outline, height, [(0, 1, 2, 3), (0, 3, 4, 5)])
    if family == "bridge":
        foot, arch = 0.3 * width, 0.55 * depth
        outline = [(0, 0), (foot, 0), (foot, arch), (width - foot, arch), (width - foot, 0), (width, 0)]
        return form([*outline, (width, depth), (0, depth)], height, [(0, 1, 2, 7), (7, 2, 3, 6), (3, 4, 5, 6)])
    if family == "house":
        return form([(0, 0), (width, 0), (width, 0.5 * depth), (0.5 * width, depth), (0, 0.5 * depth)], height)
    if family == "slope":
        return form([(0, 0), (width, 0), (rng.uniform(0.25, 0.6) * width, depth), (0, depth)], height)
    if family == "stump":
        return form([(0, 0), (width, 0), (width, depth), (0, depth)], height, top=rng.uniform(0.6, 0.8))
    return box((width, depth, height))


def worn(model: Form, rng: np.random.Generator) -> Body:
    """As a good part is: its edges rounded by 0.05 to 0.2 mm, all else as the model says."""
    return Body(model, model, _rounded(model, rng.uniform(0.00005, 0.0002)), np.eye(4))


def imprecise(model: Form, rng: np.random.Generator) -> Body:
    """Off by up to 3 mm: of another scale, sides elsewhere, edges rounded, a corner broken off."""
    outline = model.outline * (1.0 + rng.uniform(-0.01, 0.01))
    low, high = np.array([model.low, model.high]) * (1.0 + rng.uniform(-0.01, 0.01))
    shifts = np.where(rng.random(len(outline)) < 0.35, rng.uniform(-0.002, 0.002, len(outline)), 0.0)
    outline = _moved(outline, shifts)
    high += rng.uniform(-0.0015, 0.0015)
    real = whole = Form(outline, low, high, model.top * (1.0 + rng.uniform(-0.02, 0.0)), model.parts)
    if rng.random() < 0.5:
        corners = [at for at, turn in enumerate(_turns(outline)) if turn > 0.5]
        real = _chipped(whole, int(rng.choice(corners)), rng.uniform(0.003, 0.006))
    return Body(model, real, _rounded(real, rng.uniform(0.0008, 0.003)), _best_fit(model, whole))


def _moved(outline: Floats, outwards: Floats) -> Floats:
    """An outline whose sides, each from a corner to the next, are moved outwards."""
    ahead = np.roll(outline, -1, axis=0) - outline
    normals = np.column_stack((ahead[:, 1], -ahead[:, 0])) / np.linalg.norm(ahead, axis=1, keepdims=True)
    levels = (normals * outline).sum(axis=1) + outwards
    sides = zip(np.roll(normals, 1, axis=0), normals, np.roll(levels, 1), levels, strict=True)
    return np.array([np.linalg.solve(np.array([a, b]), np.array([c, d])) for a, b, c, d in sides])


def _turns(outline: Floats) -> Floats:
    """By how much the outline turns left at each corner, in radians."""
    after = np.roll(outline, -1, axis=0) - outline
    before = np.roll(after, 1, axis=0)
    return np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))


def _chipped(whole: Form, at: int, length: float) -> Form:
    """Without a corner, so far along both of its sides."""
    outline = whole.outline
    ends = [outline[at - 1], outline[(at + 1) % len(outline)]]
    new = [outline[at] + length * (end - outline[at]) / np.linalg.norm(end - outline[at]) for end in ends]
    numbers = [[index + (index > at)] + [at + 1] * (index == at) for index in range(len(outline))]
    parts = [[number for index in part for number in numbers[index]] for part in whole.parts]
    return replace(whole, outline=np.concatenate((outline[:at], new, outline[at + 1 :])), parts=parts)


def _rounded(real: Form, radius: float) -> Mesh:
    """The surface of a form whose edges are rounded."""
    turns = _turns(real.outline)
    core = _moved(real.outline, np.full(len(turns), -radius))
    sides = np.roll(core, -1, axis=0) - core
    first = np.arctan2(sides[:, 1], sides[:, 0]) - np.pi / 2 - turns  # the normal of the side that comes in
    rings = []
    bends = np.linspace(0.02, np.pi / 2, _ARC)
    heights = [(real.low + radius * (1 - np.cos(b)), radius * np.sin(b)) for b in bends]
    heights += [(real.high - radius * (1 - np.cos(b)), radius * np.sin(b)) for b in bends[::-1]]
    owners: list[list[int]] = [[] for _ in core]
    for number, (height, reach) in enumerate(heights):
        ring = []
        for at, (corner, turn, begin) in enumerate(zip(core, turns, first, strict=True)):
            if turn <= 0.0:
                points = [corner + (real.outline[at] - corner) * reach / radius]
            else:
                ways = begin + turn * np.linspace(0.0, 1.0, _ARC)
                points = [corner + reach * np.array([np.cos(way), np.sin(way)]) for way in ways]
            if number == 0:
                owners[at] = list(range(len(ring), len(ring) + len(points)))
            ring += points
        narrower = 1.0 + (real.top - 1.0) * (height - real.low) / (real.high - real.low)
        rings.append(np.column_stack((narrower * np.array(ring), np.full(len(ring), height))))
    parts = [[point for corner in part for point in owners[corner]] for part in real.parts]
    return _lofted(np.concatenate(rings), parts, len(rings))


def _lofted(points: Floats, parts: Sequence[Sequence[int]], rings: int = 2) -> Mesh:
    """Rings of equally many points, one over the other, with sides and both caps."""
    count = len(points) // rings
    faces = []
    for ring, at in np.ndindex(rings - 1, count):
        a, b = ring * count + at, ring * count + (at + 1) % count
        faces += [(a, b, b + count), (a, b + count, a + count)]
    for part in parts:
        last = count * (rings - 1)
        for here, there in pairwise(part[1:]):
            faces += [(part[0], there, here), (part[0] + last, here + last, there + last)]
    return Mesh(points, np.array(faces, np.int32))


def _best_fit(model: Form, real: Form) -> Floats:
    """The small displacement of the model after which its sides are nearest to the real one's, by area."""
    rows, wanted = [], []
    sides, targets, count = model.corners(), real.corners(), len(model.outline)
    quads = [(at, (at + 1) % count, (at + 1) % count + count, at + count) for at in range(count)]
    quads += [tuple(range(count - 1, -1, -1)), tuple(range(count, 2 * count))]
    for quad in quads:
        own, other = sides[list(quad)], targets[list(quad)]
        normal = np.cross(own[1] - own[0], own[2] - own[0])
        weight = np.sqrt(np.linalg.norm(normal))
        normal /= np.linalg.norm(normal)
        for here, there in zip(own, other, strict=True):
            rows.append(weight * np.concatenate((normal, np.cross(here, normal))))
            wanted.append(weight * normal @ (there - here))
    return exp_se3(np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0])
