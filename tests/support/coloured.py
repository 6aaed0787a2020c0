"""Three cubes of one size on a table, each of its own colour, or not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.appearance import NOTHING
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.palette import coloured, with_colours
from hierax.nodes.tracking.estimation.profiles import Image, smoothed
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, looking_down, make_pose
from hierax.nodes.tracking.model.controls import gathered
from hierax.nodes.tracking.schema import ControlPoints, Looks
from hierax.nodes.tracking.search.multistart import FINE
from hierax.nodes.tracking.simworld.scene import develop, draw
from hierax.nodes.tracking.simworld.shapes import Thing, cube
from support.drawn import believed, seen_of

SIZE, SIDE_M = (640, 480), 0.045
INTRINSICS = np.array([800.0, 800.0, 319.5, 239.5])
CAMERA = looking_down(0.4, 0.75, 0.5, np.zeros(3))
PLACES = [make_pose(np.eye(3), np.array([x, y, SIDE_M / 2])) for x, y in ((0.0, -0.08), (0.08, 0.0), (-0.05, 0.05))]
POSES = [invert(CAMERA) @ place for place in PLACES]
RED, GREEN, BLUE = (200, 60, 50), (60, 160, 80), (70, 80, 190)


def picture(*colours: tuple[int, int, int], light: float = 1.0) -> Array:
    """The cubes on the table, uint8 RGB."""
    things = [Thing(place, cube(SIDE_M), colour) for place, colour in zip(PLACES, colours, strict=True)]
    seen = develop(draw(things, CAMERA, INTRINSICS, SIZE), 0.7, 2.0, np.random.default_rng(0))
    return np.asarray(np.rint(light * seen), dtype=np.uint8)


def controls(pose: Floats) -> ControlPoints:
    """What would be seen of a cube."""
    return seen_of([SIDE_M] * 3, pose, INTRINSICS, SIZE)


def aligned(image: Image) -> Aligned:
    """The cubes where they are."""
    every = gathered([controls(pose) for pose in POSES])
    memory = memory_of([NOTHING] * 3, every, image.shape[2])
    found = align(image, every, Start(np.stack(POSES), np.tile(1e8 * np.eye(6), (3, 1, 1))), INTRINSICS, memory, FINE)
    assert found is not None
    return found


def taught(*colours: tuple[int, int, int], images: int = 20) -> list[Looks]:
    """What so many images tell of each cube's looks."""
    shown, looks = aligned(smoothed(picture(*colours))), [NOTHING] * 3
    for _ in range(images):
        looks = [with_colours(each, coloured(shown), at, 20.0) for at, each in enumerate(looks)]
    return looks


def item(number: int, pose: Floats, looks: Looks, others: Sequence[Floats] = (), **fields: Any) -> dict[str, Any]:
    """A cube as the arm's belief has it before an image; others: poses that it may have besides."""
    known = {**believed(number, pose, controls(pose)), "nats": 20.0, "probability": 1.0, "misses": 0}
    return {**known, "slots": looks, "others": tuple(imagined(other) for other in others), **fields}


def imagined(pose: Floats) -> dict[str, Any]:
    """A pose that a cube may have."""
    return {"pose": pose, "controls": controls(pose), "kept": True}
