"""Whether a cube can be where it is seen, by where the others are: on the table or on another cube, and not within one.

A body here is {"id", "status", "pose": world_from_object, "model": {"vertices"}}; lengths are in metres."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import TABLE_MIDDLE_M
from hierax.nodes.tracking.schema import LOST, TRACKED

ODD_M = 0.012  # so far off what could carry it, or within the table or another cube, a cube cannot be
_REACH_M = 0.6  # from the table's middle, in which cubes are looked for

Body = Mapping[str, Any]


def odd_bodies(bodies: Iterable[Body]) -> set[int]:
    """The ids of those that are seen in the air, or in the table, or expected beyond all that is looked at."""
    known = [body for body in bodies if body["status"] != LOST]
    return {body["id"] for body in known if _is_odd(body, known)}


def is_sunk(body: Body, others: Iterable[Body]) -> bool:
    """Whether a body is partly in the table, or in another one."""
    foot, top = _foot_and_top(body)
    return foot < -ODD_M or any(_is_within(body, (foot, top), other) for other in others if other["id"] != body["id"])


def hangs(body: Body, others: Iterable[Body]) -> bool:
    """Whether neither the table nor another body carries a body that is above the table."""
    foot = _foot_and_top(body)[0]
    if foot < ODD_M:
        return False
    return not any(
        abs(foot - _foot_and_top(other)[1]) < ODD_M and _beside_m(body, other) < _extent_m(other)
        for other in others
        if other["id"] != body["id"]
    )


def _is_odd(body: Body, known: Iterable[Body]) -> bool:
    if body["status"] != TRACKED:
        return bool(np.linalg.norm(body["pose"][:2, 3] - TABLE_MIDDLE_M[:2]) > _REACH_M)
    return _foot_and_top(body)[0] < -ODD_M or hangs(body, known)


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
