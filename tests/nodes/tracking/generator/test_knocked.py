"""Things that are knocked: one after the other, and no thing is knocked into the table."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.tracking.generator.knocked import EVERY, FIRST, knocked
from hierax.nodes.tracking.generator.stock import random_box
from hierax.nodes.tracking.math.geometry import transform

FRAMES = FIRST + 2 * EVERY + 12


@pytest.mark.parametrize("seed", range(3))
def test_things_stand_until_they_are_hit_and_come_to_rest_on_the_table(seed: int) -> None:
    rng = np.random.default_rng(seed)
    things = [random_box(rng, (200, 30, 30)).placed(x, 0.0, 0.0) for x in (-0.4, 0.0, 0.4)]
    poses = knocked(things, np.random.default_rng(seed), FRAMES)
    assert poses.shape == (FRAMES, 3, 4, 4)
    np.testing.assert_array_equal(poses, knocked(things, np.random.default_rng(seed), FRAMES))
    steps = np.linalg.norm(np.diff(poses[..., :3, 3], axis=0), axis=-1)  # (frames - 1, things)
    assert steps[:FIRST].max() < 0.002, f"seed {seed}"  # they settle
    moved = [steps[at : at + 2].max(axis=0) for at in range(FIRST, FRAMES - 2, EVERY)]
    assert min(map(max, moved)) > 0.005, f"seed {seed}"
    hit = [int(each.argmax()) for each in moved]
    assert sorted(hit) == [0, 1, 2], f"seed {seed}"
    assert steps[-1].max() < 0.001, f"seed {seed}"
    lowest = [
        transform(pose, thing.shape.mesh.vertices)[:, 2].min() for pose, thing in zip(poses[-1], things, strict=True)
    ]
    np.testing.assert_allclose(lowest, 0.0, atol=0.002)
