"""Where something is looked for that stands: it may begin to fall over an edge of its foot."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.math.geometry import exp_so3, log_so3, transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.schema import TrackedObject
from hierax.nodes.tracking.search.multistart import _tipped

SIDES_M = (0.03, 0.04, 0.08)


def standing(up: np.ndarray) -> TrackedObject:
    item: Any = {"support": up, "controls": {"points": box_mesh(SIDES_M).vertices}}
    return cast(TrackedObject, item)


def test_a_box_tips_over_all_edges_of_its_foot_which_stays_where_it_is() -> None:
    up = np.array([0.0, 0.0, 1.0])
    every, corners = _tipped(standing(up)), box_mesh(SIDES_M).vertices
    assert len(every) == len(const.TIPPED_WAYS) * len(const.TIPPED_RAD)
    ways = []
    for turn in every:
        angle = log_so3(turn[:3, :3])
        assert np.isclose(np.linalg.norm(angle), const.TIPPED_RAD, atol=1e-9).any()
        assert abs(angle @ up) < 1e-9
        moved = transform(turn, corners)
        assert np.linalg.norm(moved - corners, axis=1).min() < 1e-9  # the corner that it tips over
        assert moved[:, 2].min() > -SIDES_M[2] / 2 - 1e-9  # none goes into the table
        ways.append(np.arctan2(angle[1], angle[0]))
    assert np.ptp(ways) > np.pi


def test_what_lies_on_its_side_tips_about_that_side() -> None:
    up = exp_so3(np.array([0.0, np.pi / 2, 0.0]))[:, 2]
    for turn in _tipped(standing(up)):
        heights = transform(turn, box_mesh(SIDES_M).vertices) @ up
        assert heights.min() > -SIDES_M[0] / 2 - 1e-9


def test_nothing_tips_that_nothing_carries() -> None:
    assert _tipped(standing(np.zeros(3))) == []


def test_a_plate_has_its_foot_everywhere() -> None:
    item: Any = {"support": np.array([0.0, 0.0, 1.0]), "controls": {"points": box_mesh((0.1, 0.06, 0.01)).vertices}}
    flat = {**item, "controls": {"points": item["controls"]["points"] * [1.0, 1.0, 0.0]}}
    for turn in _tipped(cast(TrackedObject, flat)):
        moved = transform(turn, flat["controls"]["points"])
        assert moved[:, 2].min() > -1e-9
