"""Things for generated scenes: shapes of random sizes, how they can lie, and how several find room on a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, make_pose
from hierax.nodes.tracking.simworld.shapes import Shape, Thing, angle_piece, box, wedge

cv2.setNumThreads(1)

# world_from_object of what lies as it was extruded, and of what has its y axis upwards.
_UPRIGHT = np.eye(3)
LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

_TRIES = 400


class Item(NamedTuple):
    """A thing that has no place yet."""

    shape: Shape  # its form
    rest: Floats  # (3, 3) rotation in which it lies steadily
    colour: tuple[int, int, int]  # RGB, 0 to 255

    @property
    def height_m(self) -> float:
        """How high it is as it lies."""
        return float(np.ptp(self.shape.mesh.vertices @ self.rest.T, axis=0)[2])

    def placed(self, x_m: float, y_m: float, yaw_rad: float, bottom_m: float = 0.0) -> Thing:
        """The thing on a level plane, its frame's origin over (x, y)."""
        rotation = exp_so3(np.array([0.0, 0.0, yaw_rad])) @ self.rest
        lowest = float((self.shape.mesh.vertices @ rotation.T)[:, 2].min())
        return Thing(make_pose(rotation, np.array([x_m, y_m, bottom_m - lowest])), self.shape, self.colour)


def random_box(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A box with sides of 35 to 100 mm, no two alike."""
    while True:
        size = rng.uniform(0.035, 0.1, 3)
        if np.diff(np.sort(size)).min() > 0.006 and size[2] < 1.9 * size[:2].min():
            return Item(box(size.tolist()), _UPRIGHT, colour)


def flat_box(rng: np.random.Generator, colour: tuple[int, int, int], width_m: float) -> Item:
    """A box for a tower: about so wide, and 30 to 50 mm high."""
    return Item(box((width_m, width_m * rng.uniform(0.75, 0.92), rng.uniform(0.03, 0.05))), _UPRIGHT, colour)


def random_mesh(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A wedge or an angle piece, lying or upright."""
    width, depth, length = _sizes(rng)
    if rng.random() < 0.5:
        return Item(wedge(width, depth, length, rng.uniform(0.3, 0.7)), LYING, colour)
    lying = rng.random() < 0.5
    return Item(angle_piece(width, depth, rng.uniform(0.018, 0.028), length), LYING if lying else _UPRIGHT, colour)


def random_wedge(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A wedge, lying."""
    width, depth, length = _sizes(rng)
    return Item(wedge(width, depth, length, rng.uniform(0.3, 0.7)), LYING, colour)


def _sizes(rng: np.random.Generator) -> tuple[float, float, float]:
    return rng.uniform(0.055, 0.095), rng.uniform(0.045, 0.075), rng.uniform(0.04, 0.09)


def colours(rng: np.random.Generator, count: int) -> list[tuple[int, int, int]]:
    """Different paints."""
    hues = (rng.uniform(0, 180) + 180.0 / count * rng.permutation(count)) % 180
    shades = np.stack((hues, rng.uniform(70, 200, count), rng.uniform(110, 230, count)), axis=1).astype(np.uint8)
    rgb = cv2.cvtColor(shades[None], cv2.COLOR_HSV2RGB)[0]
    return [(int(r), int(g), int(b)) for r, g, b in rgb]


def greys(rng: np.random.Generator, count: int, middle: float) -> list[tuple[int, int, int]]:
    """Paints that can hardly be told from one another."""
    levels = np.clip(middle + rng.uniform(-12.0, 12.0, count), 0, 255)
    tints = levels[:, None] + rng.uniform(-2.0, 2.0, (count, 3))
    return [(round(r), round(g), round(b)) for r, g, b in tints]


def scattered(
    items: Sequence[Item], rng: np.random.Generator, radius_m: float, gap_m: float, taken: Sequence[Thing] = ()
) -> list[Thing] | None:
    """Put items on the table, one after the other, at random in a disc around the origin, with some room between them
    and what is taken already; None where no room was found."""
    placed: list[Thing] = []
    prints = [footprint(thing, gap_m) for thing in taken]
    for item in items:
        for _ in range(_TRIES):
            turn, yaw = rng.uniform(-np.pi, np.pi, 2)
            reach = radius_m * np.sqrt(rng.random())
            thing = item.placed(reach * np.cos(turn), reach * np.sin(turn), yaw)
            own = footprint(thing, gap_m)
            if not any(cv2.intersectConvexConvex(own, other)[0] > 0.0 for other in prints):
                prints.append(own)
                placed.append(thing)
                break
        else:
            return None
    return placed


def stacked(items: Sequence[Item], rng: np.random.Generator, x_m: float, y_m: float) -> list[Thing]:
    """Items on top of one another, the first below, each a little off and turned."""
    tower: list[Thing] = []
    bottom, yaw = 0.0, rng.uniform(-np.pi, np.pi)
    for item in items:
        off = rng.uniform(-0.006, 0.006, 2) if tower else np.zeros(2)
        tower.append(item.placed(x_m + off[0], y_m + off[1], yaw, bottom))
        bottom += item.height_m
        yaw += rng.uniform(-0.6, 0.6)
    return tower


def footprint(thing: Thing, gap_m: float) -> Array:
    """Convex hull (n, 1, 2) of what a thing covers of the table, with half the gap around it; float32, millimetres."""
    corners = np.concatenate(thing.parts())[:, :2]
    around = 0.5 * gap_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    grown = (corners[:, None] + around[None]).reshape(-1, 2)
    return np.asarray(cv2.convexHull((1000.0 * grown).astype(np.float32)))
