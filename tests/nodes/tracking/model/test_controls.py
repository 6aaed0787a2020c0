"""Control points of several objects: told apart, thinned out, and the same on the way as at the end of it."""

from __future__ import annotations

import numpy as np
from support.drawn import FIRST, SECOND, expected

from hierax.nodes.tracking.math.batched import only
from hierax.nodes.tracking.model.controls import EDGE_SLOTS, Controls, gathered


def both() -> Controls:
    return gathered([expected(box, box.pose)["controls"] for box in (FIRST, SECOND)])


def test_what_is_gathered_is_what_was_sent_one_object_behind_the_other() -> None:
    controls = both()
    for number, box in enumerate((FIRST, SECOND)):
        sent = expected(box, box.pose)["controls"]
        own = only(controls, controls.owners == number)
        for name, array in own.sent(own.visible.astype(np.float32)).items():
            assert np.array_equal(array, sent[name]), name
            assert array.dtype == sent[name].dtype, name


def test_edges_of_different_objects_have_different_numbers_but_slots_of_their_own_edge() -> None:
    controls = both()
    first, second = (controls.numbers[controls.owners == number] for number in (0, 1))
    assert np.intersect1d(controls.edges[controls.owners == 0], controls.edges[controls.owners == 1]).size
    assert not np.intersect1d(first, second).size
    assert (np.diff(controls.numbers) >= 0).all()
    assert np.array_equal(controls.slots // EDGE_SLOTS, np.stack((controls.edges,) * 2, axis=1))
    assert np.array_equal((controls.slots % 65536)[:, 1] > 0, controls.creases)


def test_rows_are_thinned_out_evenly_and_stand_as_objects_of_their_own() -> None:
    controls = both()
    places = controls.rows_of([1, 0, 1], 20)
    several = controls.of(places)
    assert all(
        len(rows) <= 20 and (controls.owners[rows] == owner).all()
        for rows, owner in zip(places, (1, 0, 1), strict=True)
    )
    assert np.array_equal(np.unique(several.owners), [0, 1, 2])
    assert np.array_equal(several.points, controls.points[np.concatenate(places)])
    assert len(controls.of([]).owners) == 0
