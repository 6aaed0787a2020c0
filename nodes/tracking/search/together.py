"""Which poses several objects have together: no two in one place or of the same edges, each carried by something."""

from collections.abc import Collection, Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, transform


class Judged(NamedTuple):
    """Poses of missing objects, aligned."""

    owners: Array  # (n,) whose
    fine: Aligned
    nats: Floats  # (n,) by how much each explains the image better than clutter does
    worth: Floats  # (n,) the same, and how likely it was before
    covariance: Floats  # (n, 6, 6)
    boxes: Floats  # (n, 2, 3) low and high corner in the object's frame
    edges: list[Floats]  # of each, (k, 4) pixels and normals of those edges that the image shows


class Together(NamedTuple):
    """Poses that several objects may have."""

    options: Mapping[int, list[int]]  # of each, the rows of its poses
    worth: Floats  # of each row, nats
    conflicts: set[tuple[int, int]]  # rows that cannot both be
    carriers: Mapping[int, set[int]]  # of each row that nothing carries which is known: those that would
    bodies: int  # how many may carry others

    def best(self, without: Collection[int]) -> tuple[float, dict[int, int]]:
        """The most that one choice for each object, or none, is worth, and that choice, some rows left out."""
        partial: list[tuple[float, dict[int, int]]] = [(0.0, {})]
        for at, rows in self.options.items():
            partial += [
                (value + float(self.worth[row]), {**chosen, at: row})
                for value, chosen in partial
                for row in rows
                if row not in without and not any((row, other) in self.conflicts for other in chosen.values())
            ]
        carried = [(value - self._unlikely(chosen), chosen) for value, chosen in partial]
        return max(carried, key=lambda each: each[0])

    def _unlikely(self, chosen: Mapping[int, int]) -> float:
        """Nats: of what floats, one that is not placed may carry each."""
        rows = chosen.values()
        floating = sum(row in self.carriers and self.carriers[row].isdisjoint(rows) for row in rows)
        return const.FLOATS * floating + const.FALLS * max(0, floating - (self.bodies - len(rows)))


def look_alike(judged: Judged, row: int, rows: Sequence[int]) -> list[int]:
    """Those rows of an object that put it at the same place with the same outlines, about, whichever side is where."""
    controls = judged.fine.stage.controls

    def outlines(number: int) -> Floats:
        return transform(judged.fine.poses[number], controls.points[controls.owners == number])

    own = outlines(row)
    apart = {other: np.linalg.norm(own[:, None] - outlines(other)[None], axis=-1) for other in rows}
    return [
        other for other, away in apart.items() if max(away.min(axis=0).mean(), away.min(axis=1).mean()) < const.TWIN_M
    ]


def conflicts_of(judged: Judged, rows: Sequence[int]) -> set[tuple[int, int]]:
    """Rows of different objects of which one is in the other, or has its edges where the other has them."""
    poses, boxes, edges = judged.fine.poses, judged.boxes, judged.edges
    return {
        pair
        for one, other in permutations(rows, 2)
        if judged.owners[one] != judged.owners[other]
        and (is_in(poses[one], boxes[one], poses[other], boxes[other]) or _is_claimed(edges[one], edges[other]))
        for pair in ((one, other), (other, one))
    }


def carriers_of(
    judged: Judged, rows: Sequence[int], staying: Sequence[tuple[Floats, Floats]], level: Floats
) -> dict[int, set[int]]:
    """Of each row that is neither on the table nor on what stays there, the other rows that would carry it."""
    carriers = {}
    for row in rows:
        box = judged.boxes[row]
        corners = transform(judged.fine.poses[row], box.mean(axis=0) + const.BOX_CORNERS * np.ptp(box, axis=0))
        heights = corners @ level[:3] + level[3]
        below = corners.mean(axis=0) - (0.5 * np.ptp(heights) + const.LIES_M) * level[:3]
        if heights.min() > const.LIES_M and not any(_holds(below, *each) for each in staying):
            carriers[row] = {other for other in rows if _holds(below, judged.fine.poses[other], judged.boxes[other])}
    return carriers


def _holds(point: Floats, pose: Floats, box: Floats) -> bool:
    """Whether a point (3,) is in a body's box, about."""
    local = transform(invert(pose), point[None])[0]
    return bool(((local > box[0] - const.LIES_M) & (local < box[1] + const.LIES_M)).all())


def _is_claimed(edges: Floats, others: Floats) -> bool:
    """Whether too many of a pose's edges in the image, (n, 4) pixels and normals, are another's, too."""
    if not len(edges) or not len(others):
        return False
    near = np.linalg.norm(edges[:, None, :2] - others[None, :, :2], axis=-1) < const.SPACING_PX
    parallel = np.abs(edges[:, 2:] @ others[:, 2:].T) > const.PARALLEL
    return bool((near & parallel).any(axis=1).mean() > const.CLAIMED)


def is_in(pose: Floats, box: Floats, other: Floats, around: Floats) -> bool:
    """Whether more of a box than bodies can share is inside of another one."""
    points = box.mean(axis=0) + const.BOX_SAMPLES * np.ptp(box, axis=0)
    inside = transform(invert(other) @ pose, points)
    return bool(((inside > around[0]) & (inside < around[1])).all(axis=1).mean() > const.SHARED)
