"""Edges that stand near others in the image, and edges that stand alone."""

from __future__ import annotations

import numpy as np
from support.boxes import INTRINSICS

from hierax.nodes.tracking.estimation.joint_alignment import apartness
from hierax.nodes.tracking.model.controls import Controls

POSE = np.eye(4)[None].repeat(2, axis=0)


def ruled(*lines: tuple[int, float, float, float]) -> Controls:
    """Upright lines of 20 control points: owner, pixels to the right, metres away, chance to be seen."""
    points = []
    for _, right, away, _ in lines:
        down = np.linspace(-40.0, 40.0, 20) / INTRINSICS[1] * away
        points.append(np.stack((np.full(20, right / INTRINSICS[0] * away), down, np.full(20, away)), axis=1))
    count = 20 * len(lines)
    owners = np.repeat([owner for owner, *_ in lines], 20)
    edges = np.repeat(np.arange(len(lines)), 20).astype(np.int32)
    tangents, inwards = np.tile([0.0, 1.0, 0.0], (count, 1)), np.tile([1.0, 0.0, 0.0], (count, 1))
    visible = np.repeat([chance for *_, chance in lines], 20)
    kinds, faces = np.zeros(count, dtype=np.uint8), np.zeros((count, 2), dtype=np.int32)
    return Controls(owners, np.concatenate(points), tangents, inwards, kinds, edges, faces, visible)


def each(controls: Controls) -> np.ndarray:
    """Of each line the mean."""
    return apartness(controls, POSE, INTRINSICS).reshape(-1, 20).mean(axis=1)


def test_edges_far_apart_stand_alone() -> None:
    assert np.array_equal(each(ruled((0, 0.0, 0.5, 1.0), (0, 6.0, 0.6, 1.0))), [1.0, 1.0])


def test_the_nearer_two_edges_are_the_less_either_stands_alone() -> None:
    apart = [each(ruled((0, 0.0, 0.5, 1.0), (0, pixels, 0.6, 1.0))) for pixels in (2.9, 2.0, 1.0, 0.1)]
    assert (np.diff(apart, axis=0) < 0.0).all()
    assert np.all(apart[-1] < 0.01)


def test_the_edges_of_another_object_count_as_far_as_they_are_likely_to_be_seen() -> None:
    seen, hardly = (each(ruled((0, 0.0, 0.5, 1.0), (1, 1.0, 0.5, chance))) for chance in (1.0, 0.1))
    assert seen[0] < 0.15
    assert hardly[0] > 0.9
    assert hardly[1] < 0.15


def test_an_edge_that_is_listed_twice_stands_alone() -> None:
    assert np.array_equal(each(ruled((0, 0.0, 0.5, 1.0), (0, 0.1, 0.5, 1.0))), [1.0, 1.0])


def test_edges_that_cross_do_not_crowd_each_other() -> None:
    upright = ruled((0, 0.0, 0.5, 1.0), (0, 1.0, 0.5, 1.0))
    turned = upright.points.copy()
    turned[20:] = turned[20:, [1, 0, 2]]
    assert apartness(upright._replace(points=turned), POSE, INTRINSICS).min() == 1.0
