"""Control points: points on edges of objects that a camera is expected to see, of one object or of several."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.math.batched import only
from hierax.nodes.tracking.math.geometry import Array, Floats
from hierax.nodes.tracking.schema import ControlPoints

OUTLINE, CREASE, LIMB = 0, 1, 2
Ints = NDArray[np.int32]
Indices = NDArray[np.intp]

_PART_M = 0.008
_PARTS = 4096
_FACES = 65536
EDGE_SLOTS = _PARTS * _FACES  # a slot's number over this is its edge's


class Controls(NamedTuple):
    """Control points, each object's together and sorted by edge, in the object's frame."""

    owners: Indices  # (n,) index of the object (of its pose in the stack of poses), ascending
    points: Floats  # (n, 3) metres
    tangents: Floats  # (n, 3) unit vectors along the edge
    # (n, 3) unit vectors across the edge in the first face that is seen beside it, away from the edge; on the outline
    # of a smooth surface, into the body
    inwards: Floats
    kinds: NDArray[np.uint8]  # (n,) `OUTLINE`, `CREASE` or `LIMB`, the outline of a smooth surface
    # (n,) number of the object's edge, the same whatever is seen of it; edges are about straight, rims in arcs. An
    # outline of a smooth surface is numbered by the direction to which it bounds the surface.
    edges: Ints
    # (n, 2) numbers of the patches of the surface seen beside it, the one of `inwards` first; -1: none
    faces: Ints
    visible: Floats  # (n,) the chance that nothing else hides it

    @property
    def creases(self) -> NDArray[np.bool_]:
        """(n,) whether the object is on both sides."""
        return np.asarray(self.kinds == CREASE)

    @property
    def limbs(self) -> NDArray[np.bool_]:
        """(n,) whether it is where a smooth surface turns away: no place of the model's, but the view's."""
        return np.asarray(self.kinds == LIMB)

    @property
    def numbers(self) -> Indices:
        """(n,) of the edges, different for different objects, ascending."""
        return np.asarray(self.owners * (int(self.edges.max(initial=-1)) + 1) + self.edges, dtype=np.intp)

    @property
    def slots(self) -> NDArray[np.int64]:
        """(n, 2) where the colours inside and outside are remembered (see `appearance`): numbers for the object's edge,
        the part of it that a point is on, and the face on either side."""
        part = np.floor(np.einsum("nk,nk->n", self.points, self.tangents) / _PART_M).astype(np.int64)
        place = self.edges.astype(np.int64) * _PARTS + (part + _PARTS // 2) % _PARTS
        return np.asarray(place[:, None] * _FACES + (self.faces.astype(np.int64) + 1))

    def rows_of(self, chosen: Sequence[int], most: int) -> list[Indices]:
        """Of each of some objects the rows of its controls, evenly thinned out to at most so many."""
        rows = {number: np.nonzero(self.owners == number)[0] for number in set(chosen)}
        return [rows[number][:: max(1, -(-len(rows[number]) // most))] for number in chosen]

    def of(self, places: Sequence[Indices]) -> "Controls":
        """The controls in some rows, as if each group of rows were an object of its own."""
        owners = np.repeat(np.arange(len(places)), [len(rows) for rows in places])
        rows = np.concatenate(places) if places else np.zeros(0, dtype=np.intp)
        return only(self, rows)._replace(owners=owners)

    def sent(self, chances: Array) -> ControlPoints:
        """One object's as they travel, with the chance of each that nothing hides it."""
        own = self._replace(visible=chances)._asdict()
        del own["owners"]
        return cast(ControlPoints, own)


def gathered(objects: Sequence[ControlPoints]) -> Controls:
    """The controls of objects, as they travelled, one object's after the other's."""
    owners = np.repeat(np.arange(len(objects)), [len(item["points"]) for item in objects])
    tables = [cast(Mapping[str, Array], item) for item in objects]
    columns = [np.concatenate([table[name] for table in tables]) for name in Controls._fields[1:]]
    return Controls(owners, *columns)._replace(visible=columns[-1].astype(np.float64))
