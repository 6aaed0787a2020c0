"""Colours beside edges: learnt, recalled, and strange where another edge is taken for the object's."""

from __future__ import annotations

from typing import Any

import numpy as np
from support.boxes import INTRINSICS, photograph
from support.drawn import FIRST, expected

from hierax.nodes.tracking.estimation.appearance import (
    NOTHING,
    measured,
    moved,
    only_found,
    recalled,
    remembered,
    sought,
    strangeness,
)
from hierax.nodes.tracking.estimation.profiles import Profiles, lines_of, read_profiles, smoothed
from hierax.nodes.tracking.math.batched import only
from hierax.nodes.tracking.model.controls import EDGE_SLOTS, Controls, gathered
from hierax.schemas.values import decode_value, encode_value


def read(image: np.ndarray) -> tuple[Controls, np.ndarray, Profiles]:
    controls = gathered([expected(FIRST, FIRST.pose)["controls"]])
    lines = lines_of(controls, FIRST.pose[None], INTRINSICS, image.shape)
    return controls, lines.rows, read_profiles(smoothed(image), lines, controls.edges[lines.rows], 6, 1.5)


def learnt(frames: int, slots: dict[str, Any] = NOTHING) -> dict[str, Any]:
    for seed in range(frames):
        controls, rows, profiles = read(photograph([FIRST], 2.0, np.random.default_rng(seed)))
        columns = np.abs(profiles.places).argmin(axis=1)
        at = np.arange(len(rows))
        colours = np.stack((profiles.inside[at, columns], profiles.outside[at, columns]), axis=1)
        slots = remembered(slots, controls, rows, colours)
    return slots


def test_the_own_edges_look_familiar_and_others_strange() -> None:
    slots = learnt(5)
    image = photograph([FIRST], 2.0, np.random.default_rng(9))
    controls, rows, profiles = read(image)
    nearest = np.abs(profiles.places).argmin(axis=1)
    memory = recalled([slots], controls, 1)
    own = strangeness(only(memory, rows), profiles)[np.arange(len(rows)), nearest]
    assert np.quantile(own, 0.9) < 0.5
    # The same edges with everything much brighter beside one of them are not the same.
    shifted = profiles._replace(inside=profiles.inside + np.float32(60.0) * (np.arange(13) > 6)[None, :, None])
    other = strangeness(only(memory, rows), shifted)[:, 8]
    assert np.median(other) > 1.0


def test_nothing_is_strange_before_anything_was_learnt() -> None:
    controls, rows, profiles = read(photograph([FIRST], 2.0, np.random.default_rng(1)))
    assert not strangeness(only(recalled([NOTHING], controls, 1), rows), profiles).any()
    assert not strangeness(only(recalled([learnt(3)], controls, 3), rows), profiles).any()


def test_edges_that_are_off_again_and_again_are_trusted_less_until_the_object_moves() -> None:
    controls, _, _ = read(photograph([FIRST], 2.0, np.random.default_rng(1)))
    numbers = controls.slots[:, 0] // EDGE_SLOTS
    first = numbers == numbers[0]
    slots = NOTHING
    for _ in range(30):
        slots = measured(slots, numbers, np.where(first, 0.8, 0.0))
    trust = recalled([slots], controls, 1).trust
    assert trust[first].max() < 0.2
    assert trust[~first].min() > 0.99
    for _ in range(20):
        slots = moved(slots)
    assert recalled([slots], controls, 1).trust.min() > 0.9


def test_parts_of_edges_that_are_never_found_are_trusted_less_until_they_are() -> None:
    controls, _, _ = read(photograph([FIRST], 2.0, np.random.default_rng(1)))
    parts = controls.slots[:, 0]
    blank = parts == parts[0]
    slots = NOTHING
    for _ in range(12):
        slots = sought(slots, parts, ~blank)
    trust = recalled([only_found(slots)], controls, 1).trust
    assert trust[blank].max() < 0.05
    assert trust[~blank].min() == 1.0
    for _ in range(30):
        slots = sought(slots, parts, np.ones(len(parts), dtype=bool))
    assert recalled([slots], controls, 1).trust.min() > 0.75
    assert sought(slots, parts[:0], blank[:0]) is slots


def test_a_memory_is_a_value_and_what_it_came_from_stays() -> None:
    slots = learnt(2)
    kept = encode_value(slots)
    learnt(1, slots)
    moved(slots)
    assert encode_value(slots) == kept
    assert encode_value(decode_value(kept)) == kept
