"""Which poses several objects have together: no two in one place or of the same edges, each carried by something."""

from collections.abc import Collection, Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, is_behind, transform


class Judged(NamedTuple):
    """Poses of missing objects, aligned."""

    owners: Array  # (n,) whose
    fine: Aligned
    nats: Floats  # (n,) by how much each explains the image better than clutter does
    worth: Floats  # (n,) the same, and how likely it was before
    covariance: Floats  # (n, 6, 6)
    boxes: Floats  # (n, 2, 3) low and high corner in the object's frame
    edges: list[Floats]  # of each, (k, 4) pixels and normals of those edges that the image shows
    lines: Floats  # (k,) nats that each control point of `fine` says of its own
    beside: Floats  # (n,) nats that what lies beside the edges says
    colours: Floats  # (n,) nats of these that are said by what colours the object is known to have
    known: Array  # (n,) whether these say that it is this object, no other one that is missing, and its edges fit well
    fits: Array  # (n,) whether enough of its edges is found: of a model that was judged before, more


class Hidden(NamedTuple):
    """What other rows hide of each, and what those parts say."""

    says: Mapping[int, Floats]  # of each row, nats: each of its control points, with its part of what lies beside edges
    behind: Mapping[tuple[int, int], Array]  # by a row and one of another object: which of its points that hides

    def gain(self, row: int, others: Collection[int]) -> float:
        """Nats that a row gains where others hide parts of it: what those say, taken back once."""
        parts = [self.behind[row, other] for other in others if (row, other) in self.behind]
        return -float(self.says[row][np.logical_or.reduce(parts)].sum()) if parts else 0.0

    def hope(self, row: int) -> float:
        """Nats that a row gains at most, whichever others there are."""
        parts = [part for (hidden, _), part in self.behind.items() if hidden == row]
        return float(np.maximum(-self.says[row][np.logical_or.reduce(parts)], 0.0).sum()) if parts else 0.0


class Together(NamedTuple):
    """Poses that several objects may have."""

    options: Mapping[int, list[int]]  # of each, the rows of its poses
    worth: Floats  # of each row, nats
    conflicts: set[tuple[int, int]]  # rows that cannot both be
    carriers: Mapping[int, set[int]]  # of each row that nothing carries which is known: those that would
    bodies: int  # how many may carry others
    hidden: Hidden

    def best(self, without: Collection[int]) -> tuple[float, dict[int, int]]:
        """The most that one choice for each object, or none, is worth, and that choice, some rows left out.

        Choices are followed object by object, the likelier rows first, as long as what is left may be worth more than
        the best one so far; `CHOICES` of them at most."""
        hopes = {row: float(self.worth[row]) + self.hidden.hope(row) for rows in self.options.values() for row in rows}
        columns = [
            (at, sorted((row for row in rows if row not in without), key=lambda row: -hopes[row]))
            for at, rows in self.options.items()
        ]
        left = [0.0]
        for _, rows in reversed(columns):
            left.append(left[-1] + max(0.0, *(hopes[row] for row in rows)) if rows else left[-1])
        left.reverse()
        best: tuple[float, dict[int, int]] = (0.0, {})
        pending: list[tuple[int, float, dict[int, int]]] = [(0, 0.0, {})]
        for _ in range(const.CHOICES):
            if not pending:
                break
            number, hope, chosen = pending.pop()
            if hope + left[number] <= best[0]:
                continue
            if number == len(columns):
                best = max(best, (self._value(chosen), chosen), key=lambda each: each[0])
                continue
            at, rows = columns[number]
            free = [row for row in rows if not any((row, other) in self.conflicts for other in chosen.values())]
            pending.append((number + 1, hope, chosen))
            pending += ((number + 1, hope + hopes[row], {**chosen, at: row}) for row in reversed(free))
        return best

    def _value(self, chosen: Mapping[int, int]) -> float:
        """Nats that a choice is worth: of what floats, one that is not placed may carry each."""
        rows = chosen.values()
        said = sum(float(self.worth[row]) + self.hidden.gain(row, rows) for row in rows)
        floating = sum(row in self.carriers and self.carriers[row].isdisjoint(rows) for row in rows)
        return said - const.FLOATS * floating - const.FALLS * max(0, floating - (self.bodies - len(rows)))


def look_alike(judged: Judged, row: int, rows: Sequence[int]) -> list[int]:
    """Those rows of an object that show the same outlines in the same place, about, whichever side is where. How far
    away it is is what outlines tell least of, and what the next images tell of what is found."""
    controls = judged.fine.stage.controls
    away = float(judged.fine.poses[row][2, 3])

    def outlines(number: int) -> Floats:
        seen = transform(judged.fine.poses[number], controls.points[controls.owners == number])
        return seen[:, :2] * (away / seen[:, 2:])

    own = outlines(row)
    apart = {other: np.linalg.norm(own[:, None] - outlines(other)[None], axis=-1) for other in rows}
    return [
        other for other, each in apart.items() if max(each.min(axis=0).mean(), each.min(axis=1).mean()) < const.TWIN_M
    ]


def conflicts_of(judged: Judged, rows: Sequence[int], level: Floats) -> set[tuple[int, int]]:
    """Rows of different objects of which one is in the other, or has its edges where the other has them: more than
    where one stands on the other."""
    poses, boxes, edges = judged.fine.poses, judged.boxes, judged.edges
    feet = {row: _below(poses[row], boxes[row], level) for row in rows}

    def is_impossible(one: int, other: int) -> bool:
        if is_in(poses[one], boxes[one], poses[other], boxes[other]):
            return True
        stacked = _holds(feet[one], poses[other], boxes[other]) or _holds(feet[other], poses[one], boxes[one])
        return not stacked and _is_claimed(edges[one], edges[other])

    return {
        pair
        for one, other in permutations(rows, 2)
        if judged.owners[one] != judged.owners[other] and is_impossible(one, other)
        for pair in ((one, other), (other, one))
    }


def hidden_of(judged: Judged, rows: Sequence[int]) -> Hidden:
    """What each row of those hides of rows of other objects."""
    controls = judged.fine.stage.controls
    seen = np.einsum("nij,nj->ni", judged.fine.poses[controls.owners][:, :3, :3], controls.points)
    seen += judged.fine.poses[controls.owners][:, :3, 3]
    whole = np.maximum(np.bincount(controls.owners, controls.visible, len(judged.owners)), 1e-9)
    says = judged.lines + controls.visible / whole[controls.owners] * judged.beside[controls.owners]
    own = {row: controls.owners == row for row in rows}
    behind: dict[tuple[int, int], Array] = {}
    for other in rows:
        hidden = is_behind(seen, judged.fine.poses[other], judged.boxes[other], const.LIES_M) & (controls.visible > 0.0)
        behind |= {
            (row, other): hidden[own[row]]
            for row in rows
            if judged.owners[row] != judged.owners[other] and hidden[own[row]].any()
        }
    return Hidden({row: says[own[row]] for row in rows}, behind)


def carriers_of(
    judged: Judged, rows: Sequence[int], staying: Sequence[tuple[Floats, Floats]], level: Floats
) -> dict[int, set[int]]:
    """Of each row that is neither on the table nor on what stays there, the other rows that would carry it."""
    carriers = {}
    for row in rows:
        below = _below(judged.fine.poses[row], judged.boxes[row], level)
        lowest = float(below @ level[:3] + level[3]) + const.LIES_M
        if lowest > const.LIES_M and not any(_holds(below, *each) for each in staying):
            carriers[row] = {other for other in rows if _holds(below, judged.fine.poses[other], judged.boxes[other])}
    return carriers


def _below(pose: Floats, box: Floats, level: Floats) -> Floats:
    """(3,) the point just below the middle of a body's foot."""
    corners = transform(pose, box.mean(axis=0) + const.BOX_CORNERS * np.ptp(box, axis=0))
    heights = corners @ level[:3] + level[3]
    point: Floats = corners.mean(axis=0) - (0.5 * np.ptp(heights) + const.LIES_M) * level[:3]
    return point


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
