"""Whether a cube can be where it is seen, by where the others are: on the table or on another cube, and not within one.

A body here is {"id", "status", "pose": world_from_object, "model": {"vertices"}}; lengths are in metres."""

from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import TABLE_MIDDLE_M
from hierax.nodes.tracking.math.geometry import Floats, make_pose
from hierax.nodes.tracking.schema import LOST, TRACKED

ODD_M = 0.012  # so far off what could carry it, or within the table or another cube, a cube cannot be
_REACH_M = 0.6  # from the table's middle, in which cubes are looked for

Body = Mapping[str, Any]


def odd_bodies(bodies: Sequence[Body]) -> set[int]:
    """The ids of those that are seen in the air, or in the table, or expected beyond all that is looked at. What one
    that is lost may carry is not in the air."""
    known = [body for body in bodies if body["status"] != LOST]
    lost_m = [_extent_m(body) for body in bodies if body["status"] == LOST]
    return {body["id"] for body in known if _is_odd(body, known, lost_m)}


def carriers(bodies: Sequence[Body]) -> dict[int, Floats]:
    """Of cubes that are lost, those that must be where something is seen to hang that one of them may carry, and there
    the world_from_object of that which fits best: upright, its sides along those of what it stands on."""
    known = [body for body in bodies if body["status"] != LOST]
    found: dict[int, Floats] = {}
    for body in known:
        lost = [other for other in bodies if other["status"] == LOST and other["id"] not in found]
        if not lost or body["status"] != TRACKED or not hangs(body, known):
            continue
        foot = _foot_and_top(body)[0]
        tops = [(_foot_and_top(other)[1], other) for other in _overlapping(body, known)]
        top, base = max((each for each in tops if each[0] < foot), key=itemgetter(0), default=(0.0, body))
        carrier = min(lost, key=lambda other: abs(foot - top - _extent_m(other)))
        if abs(foot - top - _extent_m(carrier)) < ODD_M:
            middle = np.array([*(body["pose"][:2, 3] + base["pose"][:2, 3]) / 2, (foot + top) / 2])
            found[carrier["id"]] = make_pose(base["pose"][:3, :3], middle)
    return found


def is_sunk(body: Body, others: Iterable[Body]) -> bool:
    """Whether a body is partly in the table, or in another one."""
    foot, top = _foot_and_top(body)
    return foot < -ODD_M or any(_is_within(body, (foot, top), other) for other in others if other["id"] != body["id"])


def hangs(body: Body, others: Iterable[Body], between_m: Sequence[float] = ()) -> bool:
    """Whether neither the table nor another body carries a body that is above the table, nor one of which nobody knows
    where it is, and so high, that stands there."""
    foot = _foot_and_top(body)[0]
    if foot < ODD_M:
        return False
    tops = [0.0, *(_foot_and_top(other)[1] for other in _overlapping(body, others))]
    heights = [*tops[1:], *(top + height for top in tops for height in between_m)]
    return not any(abs(foot - height) < ODD_M for height in heights)


def _overlapping(body: Body, others: Iterable[Body]) -> list[Body]:
    """Those other bodies over which, or under which, the middle of a body is, however they are turned."""
    apart = [(other, _beside_m(body, other)) for other in others if other["id"] != body["id"]]
    return [other for other, beside_m in apart if beside_m < _extent_m(other) * 0.5**0.5]  # half the diagonal


def _is_odd(body: Body, known: Iterable[Body], lost_m: Sequence[float]) -> bool:
    if body["status"] != TRACKED:
        return bool(np.linalg.norm(body["pose"][:2, 3] - TABLE_MIDDLE_M[:2]) > _REACH_M)
    return _foot_and_top(body)[0] < -ODD_M or hangs(body, known, lost_m)


def _is_within(body: Body, heights: tuple[float, float], other: Body) -> bool:
    """Whether two bodies overlap, each taken for the upright cylinder that is in it however it is turned."""
    foot, top = _foot_and_top(other)
    overlap = min(heights[1], top) - max(heights[0], foot)
    return overlap > ODD_M and _beside_m(body, other) < (_extent_m(body) + _extent_m(other)) / 2 - ODD_M


def _foot_and_top(body: Body) -> tuple[float, float]:
    heights = body["model"]["vertices"] @ body["pose"][2, :3] + body["pose"][2, 3]
    return float(heights.min()), float(heights.max())


def _beside_m(body: Body, other: Body) -> float:
    return float(np.linalg.norm(body["pose"][:2, 3] - other["pose"][:2, 3]))


def _extent_m(body: Body) -> float:
    return float(np.ptp(body["model"]["vertices"], axis=0).max())
