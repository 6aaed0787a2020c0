"""What several objects are chosen to be together: what floats needs something that carries it."""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.search.together import Together

WORTH = np.array([38.0, 39.0, 46.0, 24.0])


def test_what_floats_does_not_take_what_another_on_the_table_explains_about_as_well() -> None:
    # A small cube in the air (row 1) looks like a larger one on the table (0); that one could be the small one's (2).
    options, conflicts = {1: [0], 2: [1, 2]}, {(0, 1), (1, 0)}
    together = Together(options, WORTH, conflicts, {1: set()}, 2)
    assert together.best(()) == (84.0, {1: 0, 2: 2})
    assert together.best([2]) == (38.0, {1: 0})


def test_what_floats_may_stand_on_one_that_is_not_found_or_on_one_that_is_chosen() -> None:
    alone = Together({1: [1]}, WORTH, set(), {1: {3}}, 2)
    assert 24.0 < alone.best(())[0] < 39.0
    assert alone.best(())[1] == {1: 1}
    stacked = Together({1: [1], 2: [3]}, WORTH, set(), {1: {3}}, 2)
    assert stacked.best(()) == (63.0, {1: 1, 2: 3})
    # Of two bodies that both float, neither carries the other: one of them is not there.
    apart = Together({1: [1], 2: [3]}, WORTH, set(), {1: set(), 3: set()}, 2)
    assert apart.best(())[1] == {1: 1}
