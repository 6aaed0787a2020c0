"""After which motions a body looks the same, as its model says or its surface shows, and what that does to poses."""

from itertools import combinations

import numpy as np

from hierax.nodes.tracking.math.batched import adjoints, hat_many, invert_many
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, make_pose, unit
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.schema import Model, Symmetry

TOLERANCE_M = 0.0005  # how far a surface that is turned may lie beside itself and be called the same

NONE: Symmetry = {"turns": np.eye(4)[None], "free": np.zeros((0, 6))}
LEVER_M = 0.05  # a turn by an angle is as large as a way by this times the angle

_LEAST_SHARE = 0.02  # of a body's size: what is so small is not all the same
_ASKED, _FIRST, _NEAREST = 150, 15, 160
_MOST_PAIRS = 4_000_000  # of points that are asked for and triangles
_FOLDS = (12, 10, 9, 8, 7, 6, 5, 4, 3, 2)
_ANY_TURNS = (0.31, 1.07, 1.9, 2.83)  # what looks the same after these looks so after all
_EVEN = 0.01  # moments of inertia that differ by less than this share may be equal
_DIRECTIONS = 60  # most of the directions of corners, edges and sides of which axes are tried
_MOST_TURNS = 64


def model_of(mesh: Mesh, symmetry: Symmetry) -> Model:
    """A model as it is told; of one without symmetry, nothing of that."""
    model: Model = {"vertices": mesh.vertices, "faces": mesh.faces}
    return model if is_plain(symmetry) else {**model, "symmetry": symmetry}


def is_plain(symmetry: Symmetry) -> bool:
    """Whether there is none."""
    return len(symmetry["turns"]) == 1 and not len(symmetry["free"])


def about(axis: Floats, point: Floats, angle: float) -> Floats:
    """(4, 4) a turn about an axis (3,) through a point (3,)."""
    rotation = exp_so3(angle * unit(axis))
    return make_pose(rotation, point - rotation @ point)


def symmetry_of(turns: list[Floats], axes: list[tuple[Floats, Floats]]) -> Symmetry:
    """A symmetry of single motions (4, 4), and of all turns about axes, each with a point of it; of two axes that are
    not one, of all turns about the first one's point."""
    free = [(unit(axis), point) for axis, point in axes]
    if any(np.linalg.norm(np.cross(free[0][0], axis)) > 0.01 for axis, _ in free):
        free = [(axis, free[0][1]) for axis in np.eye(3)]
    twists = [np.concatenate((np.cross(point, axis), axis)) for axis, point in free[: 3 if len(free) == 3 else 1]]
    return {"turns": np.stack([np.eye(4), *turns]), "free": np.array(twists).reshape(-1, 6)}


def alike(symmetry: Symmetry, poses: Floats, reference: Floats) -> Floats:
    """(n, 4, 4) of the poses at which a body looks as at each of some poses (n, 4, 4), those nearest to (4, 4)."""
    if is_plain(symmetry) or not len(poses):
        return poses
    # Not by way of the reference: what is not exact of its rotation would grow from image to image.
    return np.stack([pose @ turns_back(symmetry, pose, reference)[0] for pose in poses])


def turns_back(symmetry: Symmetry, pose: Floats, reference: Floats) -> Floats:
    """(n, 4, 4) motions of a body that leave it looking the same, after which its pose is near to a reference's: the
    one that brings it nearest first."""
    away = invert_many(reference[None]) @ pose @ symmetry["turns"]
    free = np.stack([_turned_back(each, symmetry["free"]) for each in away])
    away = away @ free
    angle = np.arccos(np.clip((np.trace(away, axis1=1, axis2=2) - 2.0) / 2.0, -1.0, 1.0))
    sizes = np.hypot(LEVER_M * angle, np.linalg.norm(away[:, :3, 3], axis=1))
    return np.asarray((symmetry["turns"] @ free)[np.argsort(sizes, kind="stable")])


def moved_along(covariance: Floats, before: Floats, after: Floats) -> Floats:
    """A covariance (6, 6) of a twist in an object's frame, when another pose is given for one that looks like it."""
    carried = adjoints(invert_many(after[None]) @ before)[0]
    return np.asarray(carried @ covariance @ carried.T)


def open_to(symmetry: Symmetry) -> Floats:
    """(6, 6) what takes a twist's part away that no image tells."""
    basis = np.linalg.qr(symmetry["free"].T)[0]
    return np.asarray(np.eye(6) - basis @ basis.T)


def kept_free(symmetry: Symmetry, covariance: Floats, predicted: Floats) -> Floats:
    """A covariance (6, 6) as an image leaves it: of what it does not tell, the prediction's."""
    told = open_to(symmetry)
    free = np.eye(6) - told
    return np.asarray(told @ covariance @ told + free @ predicted @ free)


def _turned_back(away: Floats, free: Floats) -> Floats:
    """The free motion after which something is turned away least."""
    if not len(free):
        return np.eye(4)
    if len(free) == 3:
        centre = np.array([free[1, 2], free[2, 0], free[0, 1]])
        return make_pose(away[:3, :3].T, centre - away[:3, :3].T @ centre)
    axis = free[0, 3:]
    rotation = away[:3, :3]
    sine, cosine = np.trace(rotation @ hat_many(axis[None])[0]), np.trace(rotation) - axis @ rotation @ axis
    return about(axis, np.cross(axis, free[0, :3]), float(np.arctan2(sine, cosine)))


def found_symmetry(mesh: Mesh, tolerance_m: float = TOLERANCE_M) -> Symmetry:
    """The motions after which a surface lies where it lay, with points at most so far beside it, as far as that can be
    told from it. Axes are looked for through its centre: those of inertia and, where these are not unique, those
    towards corners, along edges' middles and square to sides."""
    surface = _Surface(mesh)
    centre, tolerance_m = surface.centre, min(tolerance_m, _LEAST_SHARE * float(np.ptp(mesh.vertices, axis=0).max()))
    radii = np.linalg.norm(surface.asked - centre, axis=1)
    if np.ptp(radii) < tolerance_m:
        return symmetry_of([], [(np.eye(3)[0], centre), (np.eye(3)[1], centre)])

    def same(turn: Floats) -> bool:
        turned = surface.asked @ turn[:3, :3].T + turn[:3, 3]
        return all(surface.beside(part) < tolerance_m for part in (turned[::_FIRST], turned))

    values, vectors = np.linalg.eigh(surface.inertia)
    alike_moments = (np.diff(values) < _EVEN * values[2]).any()
    for axis in vectors.T:
        if all(same(about(axis, centre, turn)) for turn in _ANY_TURNS):
            flip = about(np.cross(axis, vectors[:, 0] + vectors[:, 1] + vectors[:, 2]), centre, np.pi)
            return symmetry_of([flip] if same(flip) else [], [(axis, centre)])
    # An axis of symmetry is one of inertia.
    further = [
        axis
        for axis in surface.directions()
        if np.linalg.norm(np.cross(surface.inertia @ axis, axis)) < _EVEN * values[2]
    ]
    axes = [*vectors.T, *further] if alike_moments else [*vectors.T]
    turns: list[Floats] = []
    for axis in axes:
        if any(np.abs(turn[:3, :3] @ axis - axis).max() < 1e-3 for turn in turns):
            continue
        fold = next((fold for fold in _FOLDS if same(about(axis, centre, 2.0 * np.pi / fold))), 1)
        turns += [about(axis, centre, 2.0 * np.pi * at / fold) for at in range(1, fold)]
    return symmetry_of(_closed(turns), [])


def _closed(turns: list[Floats]) -> list[Floats]:
    """Motions with all that they make together, but for the identity."""
    every = [np.eye(4)]
    for turn in every:
        for step in turns:
            made = turn @ step
            if len(every) < _MOST_TURNS and all(np.abs(made - other).max() > 0.02 for other in every):
                every.append(made)
    return every[1:]


class _Surface:
    """A mesh as what points are near to."""

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = 0.5 * np.linalg.norm(normals, axis=1)
        middles = corners.mean(axis=1)
        self.centre: Floats = areas @ middles / areas.sum()
        # Exact, so that a cube's moments are equal: the mean square over a triangle is that of its corners and middle.
        arms = np.concatenate((corners - self.centre, 3.0 * (middles - self.centre)[:, None]), axis=1)
        self.inertia: Floats = np.einsum("n,nki,nkj->ij", areas, arms, arms) / (12.0 * areas.sum())
        used = mesh.vertices[np.unique(mesh.faces)]
        some = min(_ASKED, max(4 * _FIRST, _MOST_PAIRS // len(areas)))
        rng = np.random.default_rng(0)
        shares, faces = rng.dirichlet((1.0, 1.0, 1.0), some), rng.choice(len(areas), some, p=areas / areas.sum())
        within = np.einsum("nk,nkd->nd", shares, corners[faces])
        self.asked: Floats = np.concatenate((used[np.unique(rng.choice(len(used), some))], within))
        self._corners, self._middles = corners, middles
        self._radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
        self._sides, self._used = unit(normals[np.argsort(-areas)]), used

    def directions(self) -> list[Floats]:
        """Towards corners that stand out, middles between neighbours of them, and square to sides."""
        arms = self._used - self.centre
        out = arms[np.argsort(-np.linalg.norm(arms, axis=1), kind="stable")][: _DIRECTIONS // 4]
        between = [one + two for one, two in combinations(out, 2)]
        chosen: list[Floats] = []
        for direction in (*self._sides[:_DIRECTIONS], *out, *between):
            axis = unit(direction)
            if len(chosen) < _DIRECTIONS and axis.any() and all(abs(axis @ other) < 0.9999 for other in chosen):
                chosen.append(axis)
        return chosen

    def beside(self, points: Floats) -> float:
        """How far the farthest of some points is from the surface."""
        squares = (points**2).sum(axis=1)[:, None] - 2.0 * points @ self._middles.T + (self._middles**2).sum(axis=1)
        least = np.sqrt(np.maximum(squares, 0.0)) - self._radii
        near = np.argpartition(least, min(_NEAREST, len(self._radii)) - 1, axis=1)[:, :_NEAREST]
        return float(np.sqrt(_squares(points, self._corners[near]).min(axis=1).max()))


def _squares(points: Floats, corners: Floats) -> Floats:
    """(n, k) squared distances of points (n, 3) from triangles (n, k, 3, 3)."""
    to = points[:, None, None] - corners
    sides = np.roll(corners, -1, axis=2) - corners
    along = np.clip((to * sides).sum(axis=3) / np.maximum((sides**2).sum(axis=3), 1e-30), 0.0, 1.0)
    nearest: Array = ((to - along[..., None] * sides) ** 2).sum(axis=3).min(axis=2)
    normals = np.cross(sides[:, :, 0], sides[:, :, 1])
    inside = ((np.cross(sides, to) * normals[:, :, None]).sum(axis=3) >= 0.0).all(axis=2)
    height = (to[:, :, 0] * unit(normals)).sum(axis=2)
    return np.where(inside & normals.any(axis=2), height**2, nearest)
