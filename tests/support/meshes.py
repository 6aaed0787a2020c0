"""Meshes for tests, as vertices (n, 3) in metres and faces (m, 3), counter-clockwise seen from outside."""

from __future__ import annotations

from typing import Any

import numpy as np

Arrays = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]

ELL_BOXES = (((0.08, 0.03, 0.06), (0.01, -0.015, 0.0)), ((0.03, 0.05, 0.06), (-0.015, 0.025, 0.0)))
"""Size and centre of the two boxes that `ell` is made of."""


def sphere(radius: float, rows: int, columns: int) -> Arrays:
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None]
    grid = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi]
    faces = []
    for row in range(rows):
        for column in range(columns):
            a, b = row * columns + column, row * columns + (column + 1) % columns
            faces += [(a, a + columns, b), (b, a + columns, b + columns)]
    return radius * np.stack(grid, axis=-1).reshape(-1, 3), np.array(faces)


def cylinder(radius: float, height: float, sides: int) -> Arrays:
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = np.stack((radius * np.cos(turn), radius * np.sin(turn)), axis=1)
    low, high = (np.column_stack((ring, np.full(sides, z))) for z in (-height / 2, height / 2))
    faces = []
    for a in range(sides):
        b = (a + 1) % sides
        faces += [
            (a, b, sides + b),
            (a, sides + b, sides + a),
            (2 * sides, b, a),
            (2 * sides + 1, sides + a, sides + b),
        ]
    centres = np.array([[0.0, 0.0, -height / 2], [0.0, 0.0, height / 2]])
    return np.concatenate((low, high, centres)), np.array(faces)


def ell() -> Arrays:
    """A body of the form of an L, 8 x 8 x 6 cm."""
    outline = np.array([[0, 0], [0.08, 0], [0.08, 0.03], [0.03, 0.03], [0.03, 0.08], [0, 0.08]]) - 0.03
    vertices = np.concatenate([np.column_stack((outline, np.full(6, z))) for z in (-0.03, 0.03)])
    faces = []
    for a in range(6):
        b = (a + 1) % 6
        faces += [(a, b, b + 6), (a, b + 6, a + 6)]
    for a, b, c in ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)):
        faces += [(c, b, a), (a + 6, b + 6, c + 6)]
    return vertices, np.array(faces)


def divided(vertices: np.ndarray[Any, Any], faces: np.ndarray[Any, Any]) -> Arrays:
    """The same surface with each triangle cut into four that share no vertices with its neighbours."""
    corners = vertices[faces]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = np.concatenate([np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return parts.reshape(-1, 3), np.arange(3 * len(parts)).reshape(-1, 3)
