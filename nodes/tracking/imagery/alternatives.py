"""Where else a body may be than it is imagined: poses to look for it at, by what physics leaves open.

Mental imagery proposes, the image decides: each of these poses is drawn as the expected one is, with what would be
seen of it there.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, exp_se3

AT_ONCE = 8  # so many poses are imagined of a body for one image
_BASES = (2, 3, 5, 7, 11, 13)
_TABLE = 512


def _normal_table() -> Floats:
    """(n, 6) evenly spread draws of standard normal variables, any few rows that follow one another, too."""
    table = np.zeros((_TABLE, len(_BASES)))
    for column, base in enumerate(_BASES):
        for row in range(_TABLE):
            number, share, value = row + 20, 1.0 / base, 0.0
            while number:
                number, digit = divmod(number, base)
                value += share * digit
                share /= base
            table[row, column] = NormalDist().inv_cdf(value)
    return table


_DRAWS = _normal_table()


def elsewhere(pose: Floats, covariance: Floats, support: Floats, turn: int) -> Floats:
    """Poses (`AT_ONCE`, 4, 4) that a body may have as well.

    Args:
        pose: world_from_object that it is imagined at; covariance: (6, 6) of that, twist in the object's frame.
        support: (3,) unit vector upwards in the object's frame where the body stands on something: there it may be
            elsewhere and turned, but not higher or tilted; zeros where nothing carries it.
        turn: other numbers give other poses.
    """
    directions = _open(support)
    within = directions.T @ covariance @ directions
    values, vectors = np.linalg.eigh(within)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    rows = (np.arange(AT_ONCE) + AT_ONCE * turn) % _TABLE
    # The widest direction gets the evenest draws.
    draws = _DRAWS[rows][:, : len(values)][:, ::-1]
    twists = draws @ spread.T @ directions.T
    return np.stack([pose @ exp_se3(twist) for twist in twists])


def _open(support: Floats) -> Floats:
    """(6, n): twists that what carries a body leaves open."""
    if not support.any():
        return np.eye(6)
    level = np.linalg.svd(support[None])[2][1:]
    directions = np.zeros((6, 3))
    directions[:3, :2] = level.T
    directions[3:, 2] = support
    return directions
