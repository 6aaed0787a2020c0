"""What of a mesh can be seen as an edge: sharp edges, in chains, and smooth surfaces that may turn away."""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.math.geometry import Array, Floats, unit

# Faces that meet at a larger angle meet in an edge that is seen; at a smaller one the surface is smooth.
SHARP_RADIANS = 0.3

_PLANAR_RADIANS = 0.005
# Vertices nearer than this share of the mesh's diameter are one: files double them along the seams of textures.
_WELD = 1e-6

_STRAIGHT = 0.94  # cosine of the largest angle between two edges that go on one another in a chain
_ARC = 0.7  # cosine of the angle to its first edge up to which a chain goes on
Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]


class Shape(NamedTuple):
    """A mesh, prepared. Everything stands in the object's frame."""

    vertices: Floats  # (v, 3) metres
    # (m, 3) indices of vertices; neighbours are wound alike, a closed surface counter-clockwise from outside
    faces: Ints
    normals: Floats  # (m, 3) unit
    closed: Flags  # (m,) whether the face belongs to a closed surface, of which only the outside is ever seen
    patches: Ints  # (m,) number of the patch of the surface, bounded by sharp edges, that the face belongs to
    edges: Ints  # (e, 2) indices of vertices: the sharp edges, chain by chain, each in its order
    edge_faces: Ints  # (e, 2) the faces beside each; the second is -1 where a sheet ends
    inwards: Floats  # (e, 2, 3) unit vectors in those faces, across the edge and away from it
    chains: Ints  # (e,) number of the chain that the edge belongs to, rising: pieces that go on about straight are one
    smooth: Ints  # (k,) faces beside which the surface bends without an edge
    smooth_patches: Ints  # (k,) which of the patches with such faces, counted from 0, each belongs to
    smooth_corners: Ints  # (k, 3) their corners, as numbers of the next two
    corners: Floats  # (u, 3) points of smooth surfaces, one for each vertex and patch
    corner_normals: Floats  # (u, 3) unit normals of the smooth surface there
    convex: bool  # whether no part of it ever hides another
    low: Floats  # low, high: (3,) of the bounding box
    high: Floats


class _Pairs(NamedTuple):
    """Edges (e, 2) of the triangles and the faces (e, 2) beside them, -1 for none; and by the faces' own winding
    whether both go along the edge in the same direction, which they should not."""

    edges: Ints
    faces: Ints
    twisted: Flags


def shape_of(vertices: Floats, faces: Array) -> Shape:
    """Prepare a mesh of vertices (n, 3) in metres, and faces (m, 3), their indices, wound in any way."""
    vertices, faces = _welded(vertices, np.asarray(faces, dtype=np.int32))
    pairs = _paired(faces)
    if pairs.twisted.any():
        faces = _wound_alike(faces, pairs)
        pairs = _paired(faces)
    sheets = _components(len(faces), pairs.faces[pairs.faces[:, 1] >= 0])
    whole = np.ones(sheets.max(initial=0) + 1, dtype=bool)
    whole[sheets[pairs.faces[pairs.faces[:, 1] < 0, 0]]] = False
    closed = whole[sheets]
    faces = _outward(vertices, faces, sheets, closed)
    normals, areas = _normals(vertices, faces)
    bend = _bend(normals, pairs)
    sharp = bend > SHARP_RADIANS
    patches = _components(len(faces), pairs.faces[~sharp])
    order, turned, chains = chained(_straight_on(vertices, pairs.edges[sharp]), 1)
    edges, edge_faces = pairs.edges[sharp][order], pairs.faces[sharp][order]
    edges = np.where(turned[:, None], edges[:, ::-1], edges)
    bent = (bend > _PLANAR_RADIANS) & ~sharp
    smooth = np.unique(pairs.faces[bent])
    convex = bool(closed.all()) and sheets.max(initial=0) == 0 and _is_convex(vertices, faces, normals, pairs)
    return Shape(
        vertices,
        faces,
        normals,
        closed,
        patches,
        edges,
        edge_faces,
        _inwards(vertices, faces, normals, edges, edge_faces),
        _bent(vertices, edges, chains),
        smooth.astype(np.int32),
        np.unique(patches[smooth], return_inverse=True)[1].ravel().astype(np.int32),
        *_corners(vertices, faces, normals * areas[:, None], patches, smooth),
        convex,
        vertices.min(axis=0),
        vertices.max(axis=0),
    )


def _welded(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """One vertex for each place, without triangles that have no area."""
    used = np.unique(faces)
    scale = _WELD * float(np.linalg.norm(np.ptp(vertices[used], axis=0))) or 1.0
    cells = np.rint(vertices[used] / scale).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    renamed = np.zeros(len(vertices), dtype=np.int32)
    renamed[used] = inverse.ravel()
    welded, faces = vertices[used][first], renamed[faces]
    a, b, c = (welded[faces[:, at]] for at in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
    return welded, np.ascontiguousarray(faces[area > scale * np.maximum(longest, scale)])


def _paired(faces: Ints) -> _Pairs:
    """Of each edge the two faces; where three or more meet, each but the last two ends there."""
    count = len(faces)
    ends = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    owner = np.tile(np.arange(count, dtype=np.int32), 3)
    forward = ends[:, 0] < ends[:, 1]
    ends = np.sort(ends, axis=1)
    order = np.lexsort((owner, ends[:, 1], ends[:, 0]))
    ends, owner, forward = ends[order], owner[order], forward[order]
    same = np.append((ends[1:] == ends[:-1]).all(axis=1), False)
    third = np.append(same[1:], False)
    first = same & ~third
    second = np.append(False, first[:-1])
    alone = ~first & ~second
    begin = np.nonzero(first | alone)[0]
    paired = first[begin]
    other = np.minimum(begin + 1, max(len(ends) - 1, 0))
    sides = np.stack((owner[begin], np.where(paired, owner[other], -1)), axis=1).astype(np.int32)
    return _Pairs(ends[begin].astype(np.int32), sides, paired & (forward[begin] == forward[other]))


def _wound_alike(faces: Ints, pairs: _Pairs) -> Ints:
    """Faces turned over until neighbours are wound alike, as far as the surface has two sides."""
    beside: list[list[tuple[int, bool]]] = [[] for _ in faces]
    for (one, other), twisted in zip(pairs.faces.tolist(), pairs.twisted.tolist(), strict=True):
        if other >= 0:
            beside[one].append((other, twisted))
            beside[other].append((one, twisted))
    turned: list[bool | None] = [None] * len(faces)
    for start in range(len(faces)):
        if turned[start] is not None:
            continue
        turned[start] = False
        waiting = deque([start])
        while waiting:
            here = waiting.popleft()
            for there, twisted in beside[here]:
                if turned[there] is None:
                    turned[there] = bool(turned[here]) != twisted
                    waiting.append(there)
    return np.where(np.array(turned, dtype=bool)[:, None], faces[:, ::-1], faces)


def _components(count: int, pairs: Ints) -> Ints:
    """Number of the component, from 0, of each of `count` things that the pairs (n, 2) join."""
    labels = np.arange(count)
    while len(pairs):
        lower = labels[pairs].min(axis=1)
        joined = labels.copy()
        for side in range(2):
            np.minimum.at(joined, labels[pairs[:, side]], lower)
        joined = joined[joined]
        if np.array_equal(joined, labels):
            break
        labels = joined
    return np.unique(labels, return_inverse=True)[1].ravel().astype(np.int32)


def _outward(vertices: Floats, faces: Ints, sheets: Ints, closed: Flags) -> Ints:
    """Closed surfaces wound counter-clockwise from outside: what they enclose is positive."""
    a, b, c = (vertices[faces[:, at]] - vertices.mean(axis=0) for at in range(3))
    volume = np.bincount(sheets, weights=np.sum(np.cross(a, b) * c, axis=1))
    inside_out = (volume < 0)[sheets] & closed
    return np.where(inside_out[:, None], faces[:, ::-1], faces)


def _normals(vertices: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Unit normals (m, 3) and areas (m,)."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-300)[:, None], 0.5 * length


def _bend(normals: Floats, pairs: _Pairs) -> Floats:
    """The angle between the faces beside each edge; π where there is one face, or two that are wound against
    each other."""
    one, other = normals[pairs.faces[:, 0]], normals[np.maximum(pairs.faces[:, 1], 0)]
    across = np.linalg.norm(np.cross(one, other), axis=1)
    angle = np.arctan2(across, np.sum(one * other, axis=1))
    return np.where((pairs.faces[:, 1] < 0) | pairs.twisted, np.pi, angle)


def _inwards(vertices: Floats, faces: Ints, normals: Floats, edges: Ints, edge_faces: Ints) -> Floats:
    along = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    found = np.zeros((len(edges), 2, 3))
    for side in range(2):
        face = np.maximum(edge_faces[:, side], 0)
        across = unit(np.cross(normals[face], along))
        middle = vertices[faces[face]].mean(axis=1)
        away = np.sum(across * (middle - vertices[edges[:, 0]]), axis=1, keepdims=True)
        found[:, side] = np.where(edge_faces[:, side : side + 1] < 0, 0.0, np.where(away < 0, -across, across))
    return found


def _straight_on(vertices: Floats, edges: Ints) -> NDArray[np.intp]:
    """Of each end of each edge the end that meets it and goes on about straight, as `chained` takes it."""
    along = unit(vertices[edges[:, 1]] - vertices[edges[:, 0]])
    ends = edges.ravel()
    order = np.argsort(ends, kind="stable")
    _, first, counts = np.unique(ends[order], return_index=True, return_counts=True)
    one, other = order[first[counts == 2]], order[first[counts == 2] + 1]
    # Both point away from the vertex or both to it where the dot product of the directions is turned over.
    turn = np.where(one % 2 != other % 2, 1.0, -1.0)
    straight = turn * np.sum(along[one // 2] * along[other // 2], axis=1) > _STRAIGHT
    beyond = np.full(len(ends), -1)
    beyond[one[straight]], beyond[other[straight]] = other[straight], one[straight]
    return beyond


def chained(beyond: NDArray[np.intp], ring_end: int) -> tuple[NDArray[np.intp], Flags, Ints]:
    """An order in which pieces follow one another, whether each is turned round in it, and the chains' numbers, from
    which end of which piece each of its two ends meets, (2n,), -1 for none; a ring begins with this end, 0 or 1, of its
    first piece."""
    across = beyond.tolist()
    # From the ends of open chains first; what is left after that are rings.
    starts = np.concatenate((np.nonzero(beyond < 0)[0], np.arange(ring_end, len(across), 2)))
    order: list[int] = []
    turned: list[bool] = []
    chains: list[int] = []
    done = [False] * (len(across) // 2)
    for start in starts.tolist():
        end = start
        chain = chains[-1] + 1 if chains else 0
        while end >= 0 and not done[end >> 1]:
            done[end >> 1] = True
            order.append(end >> 1)
            turned.append(bool(end & 1))
            chains.append(chain)
            end = across[end ^ 1]
    return np.array(order, dtype=np.intp), np.array(turned, dtype=bool), np.array(chains, dtype=np.int32)


def _bent(vertices: Floats, edges: Ints, chains: Ints) -> Ints:
    """The chains, those that bend cut into arcs."""
    along = unit(vertices[edges[:, 1]] - vertices[edges[:, 0]])
    arcs = np.zeros(len(edges), dtype=np.int32)
    first = 0
    for at in range(1, len(edges)):
        if chains[at] != chains[first] or float(along[at] @ along[first]) < _ARC:
            first = at
        arcs[at] = arcs[at - 1] + (first == at)
    return arcs


def _corners(
    vertices: Floats, faces: Ints, weighted: Floats, patches: Ints, smooth: Array
) -> tuple[Ints, Floats, Floats]:
    """Corners of some faces, numbered; where they are; and the mean of the normals of their own patch around them."""
    keys = faces.astype(np.int64) + len(vertices) * patches.astype(np.int64)[:, None]
    names, numbers = np.unique(keys, return_inverse=True)
    numbers = numbers.reshape(keys.shape)
    normals = np.zeros((len(names), 3))
    for corner in range(3):
        np.add.at(normals, numbers[:, corner], weighted)
    normals = unit(normals)
    used, places = np.unique(numbers[smooth], return_inverse=True)
    return places.reshape(-1, 3).astype(np.int32), vertices[names[used] % len(vertices)], normals[used]


def _is_convex(vertices: Floats, faces: Ints, normals: Floats, pairs: _Pairs) -> bool:
    """Whether a closed surface is convex at every edge and has the form of a sphere."""
    if len(np.unique(faces)) - len(pairs.edges) + len(faces) != 2:
        return False
    one, other = pairs.faces[:, 0], pairs.faces[:, 1]
    heights = np.einsum("eij,ej->ei", vertices[faces[other]] - vertices[pairs.edges[:, :1]], normals[one])
    return bool(heights.max() < 1e-5 * float(np.linalg.norm(np.ptp(vertices, axis=0))))
