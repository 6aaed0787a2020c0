"""Triangle meshes."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.math.geometry import Floats


class Mesh(NamedTuple):
    """A surface of triangles."""

    vertices: Floats  # (n, 3) float64, metres
    faces: NDArray[np.int32]  # (m, 3) int32, indices of vertices, counter-clockwise seen from outside


def box_mesh(size: Sequence[float]) -> Mesh:
    """A box with its centre at the origin, by its lengths in metres. Raises ValueError: a length is not positive."""
    lengths = np.asarray(size, dtype=np.float64)
    if lengths.shape != (3,) or not np.all(lengths > 0) or not np.all(np.isfinite(lengths)):
        raise ValueError(f"a box's size must be three positive lengths in metres, got {tuple(size)}")
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh(signs * lengths, triangulated(quads))


def triangulated(polygons: Sequence[Any] | NDArray[Any]) -> NDArray[np.int32]:
    """Triangles (m, 3) of convex polygons; those of fewer than three corners fall away."""
    if not isinstance(polygons, np.ndarray):
        triangles = [(face[0], face[at], face[at + 1]) for face in polygons for at in range(1, len(face) - 1)]
        polygons = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    # an index that there cannot be stays one
    return np.clip(polygons, -1, np.iinfo(np.int32).max).astype(np.int32)
