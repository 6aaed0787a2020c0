"""Where smooth surfaces turn away from the camera: lines through their triangles, chain by chain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.math.geometry import Floats, unit
from hierax.nodes.tracking.model.shapes import Ints, Shape, chained


class Outline(NamedTuple):
    """Pieces (n) of the lines at which a surface's normal is at right angles to the ray, object's frame."""

    ends: Floats  # (n, 2, 3) metres; each begins where the one before it in its chain ended
    outwards: Floats  # (n, 3) unit normals of the surface
    smooth: NDArray[np.intp]  # (n,) places in `Shape.smooth` of the faces that they cross
    chains: Ints  # (n,) number of the chain, from 0, rising


def outline_of(shape: Shape, viewpoint: Floats) -> Outline:
    """The outline of a shape's smooth surfaces, hidden or not, from the camera's centre (3,) in the object's frame."""
    towards = np.sum(shape.corner_normals * (viewpoint - shape.corners), axis=1)
    one, two, three = (towards > 0.0)[shape.smooth_corners].T
    smooth = np.nonzero((one != two) | (two != three))[0]
    places = shape.smooth_corners[smooth]
    # The one corner that faces the other way than both others; the line crosses the two sides from it.
    ahead = towards[places] > 0.0
    alone = np.where(ahead.sum(axis=1) == 1, ahead.argmax(axis=1), ahead.argmin(axis=1))
    rows = np.arange(len(alone))
    apex = places[rows, alone][:, None]
    others = np.stack((places[rows, (alone + 1) % 3], places[rows, (alone + 2) % 3]), axis=1)
    share = (towards[apex] / (towards[apex] - towards[others]))[..., None]
    ends = shape.corners[apex] + share * (shape.corners[others] - shape.corners[apex])
    normals = shape.corner_normals[apex] + share * (shape.corner_normals[others] - shape.corner_normals[apex])
    outwards = unit(normals.sum(axis=1))
    crossed = np.minimum(apex, others).astype(np.int64) * len(shape.corners) + np.maximum(apex, others)
    order, turned, chains = chained(_beyond(crossed), 0)
    ends = np.where(turned[:, None, None], ends[order, ::-1], ends[order])
    return Outline(ends, outwards[order], smooth[order], chains)


def _beyond(crossed: NDArray[np.int64]) -> NDArray[np.intp]:
    """The ends that meet, as `chained` takes them, by the side of a triangle on which each begins and ends, (n, 2)."""
    sides = crossed.ravel()
    order = np.argsort(sides, kind="stable")
    meeting = np.nonzero(sides[order][1:] == sides[order][:-1])[0]
    beyond = np.full(len(sides), -1)
    beyond[order[meeting]], beyond[order[meeting + 1]] = order[meeting + 1], order[meeting]
    return beyond
