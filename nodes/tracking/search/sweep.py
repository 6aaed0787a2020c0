"""Where an object may be of which nothing is known: poses all over the image, judged by how faces stand out.

At each control point the image is looked at a little inside of the edge and a little outside. A pose is worth much
where what is inside looks alike, face by face, and what is outside does not: a log-likelihood ratio of Gaussians, for
which no edge has to be found, and neither contrast nor noise to be known. At first that goes by every third control
point; the best poses are looked at more closely, with a map of the image's edges besides, then aligned."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.profiles import Image, Singles, grey_levels
from hierax.nodes.tracking.math.batched import only, pixels_of
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, invert, transform
from hierax.nodes.tracking.model.controls import CREASE
from hierax.nodes.tracking.schema import ControlPoints, Sweep

cv2.setNumThreads(1)


class Maps(NamedTuple):
    """What an image shows, at half its size; the last row and column are what is not in the image: 0."""

    near: Singles  # (d, h, w) nats of an edge by its direction
    colours: Singles  # (h, w, c + 1) grey levels, the last one 1 where they say something of missing objects, or 0

    def without(self, outlines: Sequence[Floats]) -> "Maps":
        """The same where what lies within pixels (n, 2) on the edges of each object that is seen says nothing."""
        seen = np.zeros(self.near.shape[1:], dtype=np.uint8)
        for pixels in outlines:
            cv2.fillConvexPoly(seen, cv2.convexHull(np.rint((pixels - 0.5) / const.SHRUNK).astype(np.int32)), 1)
        free = (cv2.dilate(seen, np.ones((3, 3), dtype=np.uint8)) == 0).astype(np.float32)
        return Maps(self.near * free, self.colours * free[..., None])


class Proposed(NamedTuple):
    """Poses of one object."""

    poses: Floats  # (n, 4, 4) camera_from_object
    templates: NDArray[np.intp]  # (n,) which of the sweep's templates each has its control points of
    nats: Floats  # (n,)


def maps_of(image: Image) -> Maps:
    """The maps of an image, as `hierax.nodes.tracking.estimation.profiles.smoothed` gives it."""
    height, width = image.shape[0] // const.SHRUNK, image.shape[1] // const.SHRUNK
    light = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).reshape(height, width, -1)
    small = grey_levels(light)
    soft = cv2.blur(small, (const.MAP_SOFT_PX, const.MAP_SOFT_PX)).reshape(small.shape)
    colours = np.concatenate((soft, np.ones_like(soft[..., :1])), axis=2)
    edges, turn = _edges(small)
    near = np.zeros((const.DIRECTIONS, height, width), dtype=np.float32)
    for at in range(const.DIRECTIONS):
        off = np.abs(
            (turn * (const.DIRECTIONS / np.pi) - at + const.DIRECTIONS / 2) % const.DIRECTIONS - const.DIRECTIONS / 2
        )
        chosen = edges & (off < 1.0)
        clutter = cv2.boxFilter(chosen.astype(np.float32), -1, (const.MAP_AROUND_PX, const.MAP_AROUND_PX))
        away = cv2.distanceTransform((~chosen).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
        density = np.exp(-0.5 * np.minimum(away / const.MAP_NEAR_PX, 6.0) ** 2) / (
            const.MAP_NEAR_PX * np.sqrt(2.0 * np.pi)
        )
        near[at] = const.ALIKE * np.log(
            1.0 - const.FOUND + const.FOUND * density / np.maximum(clutter, const.LEAST_CLUTTER)
        )
    beyond, none = (0, 1), (0, 0)
    return Maps(np.pad(near, (none, beyond, beyond)), np.pad(colours, (beyond, beyond, none)))


def swept(maps: Maps, sweep: Sweep, intrinsics: Array) -> Proposed:
    """The poses of a sweep, its places seen from the camera, that the image speaks for most, the best first."""
    places, templates = sweep["places"], sweep["templates"]
    middle = places[len(places) // 2]
    each = [(other["controls"], other["pose"], middle, intrinsics) for other in templates]
    sides = [_sides(*other) for other in each]
    rough = np.stack([_stands_out(maps.colours, places, side.at_every(const.EVERY), intrinsics) for side in sides])
    most = min(const.SECOND, rough.size)
    rows = np.sort(np.argpartition(-rough, most - 1, axis=None)[:most])  # so those of one template follow one another
    numbers, where = np.unravel_index(rows, rough.shape)
    some = [(places[where[numbers == number]], side) for number, side in enumerate(sides)]
    nats = np.concatenate([_stands_out(maps.colours, *own, intrinsics) for own in some])
    order = np.argsort(-nats, kind="stable")[: const.CLOSER]
    numbers, where = numbers[order], where[order]
    first = Proposed(places[where] @ np.stack([templates[number]["pose"] for number in numbers]), numbers, nats[order])
    return _closer(maps, sweep, sides, first, intrinsics)


def stands_out(maps: Maps, poses: Floats, controls: Sequence[ControlPoints], intrinsics: Array) -> Floats:
    """(n,) nats by which faces stand out where poses (n, 4, 4) put them, each with what would be seen there."""
    here = np.eye(4)[None]
    sides = [_sides(each, pose, here[0], intrinsics) for each, pose in zip(controls, poses, strict=True)]
    return const.ALIKE * np.array([_stands_out(maps.colours, here, side, intrinsics)[0] for side in sides])


def uncovered(
    maps: Maps, poses: Floats, controls: Sequence[ControlPoints], intrinsics: Array
) -> Sequence[ControlPoints]:
    """What would be seen where poses (n, 4, 4) put objects, each with its control points: of those that lie outside of
    the image, or where something else is seen, nothing."""
    free = maps.colours[..., -1]
    last = np.array(free.shape[::-1]) - 1
    found: list[ControlPoints] = []
    for pose, each in zip(poses, controls, strict=True):
        pixels = pixels_of(transform(pose, each["points"]), intrinsics)
        columns, rows = np.clip(np.rint((pixels - 0.5) / const.SHRUNK), -1, last).astype(np.intp).T
        found.append({**each, "visible": each["visible"] * free[rows, columns]})
    return found


class _Sides(NamedTuple):
    """Of a template, what is looked at beside its control points."""

    points: Singles  # (3, k + k) in a place's frame: those inside of each control point, then those outside
    faces: Singles  # (k + k, f) 1 where a point is on a face of the body
    own: Singles  # (f, k) 1 where a control point is on a face
    worth: Singles  # (k,)

    def at_every(self, step: int) -> "_Sides":
        """The same at every so many of the control points."""
        inside = np.arange(0, len(self.worth), step)
        chosen = np.concatenate((inside, inside + len(self.worth)))
        return _Sides(self.points[:, chosen], self.faces[chosen], self.own[:, ::step], self.worth[::step])


def _sides(controls: ControlPoints, pose: Floats, place: Floats, intrinsics: Array) -> _Sides:
    """What is looked at of a template at all places, as it is seen at one of them. Of a template whose edges lie on no
    face that is known, nothing is."""
    known = controls["faces"][:, 0] >= 0
    kinds, patches = controls["kinds"][known], controls["faces"][known]
    seen = place @ pose
    points, tangents, inwards = (controls[name][known] @ seen[:3, :3].T for name in ("points", "tangents", "inwards"))
    points = points + seen[:3, 3]
    flat = points[:, :2] / points[:, 2:]
    along = tangents[:, :2] - flat * tangents[:, 2:]
    across = np.stack((-along[:, 1], along[:, 0]), axis=1)
    across /= np.maximum(np.hypot(across[:, 0], across[:, 1]), 1e-9)[:, None]
    side = (across * (inwards[:, :2] - flat * inwards[:, 2:])).sum(axis=1)
    across *= np.where(side < 0, -const.FACE_BESIDE_PX, const.FACE_BESIDE_PX)[:, None] * points[:, 2:] / intrinsics[:2]
    moved = np.pad(across, ((0, 0), (0, 1)))
    both = np.concatenate((points + moved, points - moved)) - place[:3, 3]
    crease = kinds == CREASE
    numbers = np.concatenate((patches[:, 0], np.where(crease, patches[:, 1], -1)))
    faces = (numbers[:, None] == np.unique(patches[:, 0])).astype(np.float32)
    worth = np.where(crease, const.FACE_CREASE, 1.0).astype(np.float32)
    return _Sides((both @ place[:3, :3]).T.astype(np.float32), faces, faces[: len(worth)].T.copy(), worth)


def _stands_out(colours: Singles, places: Floats, sides: _Sides, intrinsics: Array) -> Floats:
    """(n,) by how many nats what is seen inside of a template's edges, face by face, differs from what is outside."""
    if not sides.worth.size:
        return np.full(len(places), -np.inf)
    fx, fy, cx, cy = intrinsics
    # From a place to a pixel of the maps, times the depth.
    lens = np.array([[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, const.SHRUNK]])
    views = (lens @ places[:, :3]).astype(np.float32)
    found = np.empty(len(places))
    for start in range(0, len(places), const.CHUNK):
        chunk = np.s_[start : start + const.CHUNK]
        x, y, z = (views[chunk, axis, :3] @ sides.points + views[chunk, axis, 3:] for axis in range(3))
        inverse = np.divide(np.float32(1.0), np.maximum(z, np.float32(0.02), out=z), out=z)
        x *= inverse
        y *= inverse
        looks = cv2.remap(colours, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
        found[chunk] = _differing([np.asarray(each, np.float32) for each in cv2.split(looks)], sides)
    return found


def _differing(looks: Sequence[Singles], sides: _Sides) -> Singles:
    """(n,) nats by what is looked at, each colour (n, k + k), and the last one whether it says anything: of each face
    its mean and its variance, and how far from the mean in standard deviations what lies beside it is."""
    *planes, free = looks
    channels, beside = np.float32(len(planes)), np.s_[:, len(sides.worth) :]
    count = free @ sides.faces
    least = np.maximum(count, np.float32(1.0))
    means = [plane @ sides.faces / least for plane in planes]
    square = sum(plane * plane for plane in planes) @ sides.faces
    within = np.maximum(square - least * sum(mean * mean for mean in means), 0.0) / np.maximum(least - 1.0, 1.0)
    variance = within + channels * np.float32(const.FACE_SAME**2)
    said = np.zeros(free[beside].shape, dtype=np.float32)
    for plane, mean in zip(planes, means, strict=True):
        away = mean @ sides.own
        away -= plane[beside]
        away *= away
        said += away
    said /= variance @ sides.own
    said += np.float32(1.0)
    np.log(said, out=said)
    np.minimum(said, np.float32(2.0 * const.FACE_MOST), out=said)
    said -= np.float32(2.0 * const.FACE_CHANCE)
    said *= free[beside]
    said *= (count >= const.LEAST_LOOKS).astype(np.float32) @ sides.own
    total: Singles = said @ (np.float32(0.5) * sides.worth)
    return total


def _closer(maps: Maps, sweep: Sweep, sides: Sequence[_Sides], first: Proposed, intrinsics: Array) -> Proposed:
    """Each pose where it is best, a little beside and turned; the best of those."""
    upright = sweep["places"][0, :3, 2]
    level = np.array([1.0, 0.0, 0.0]) - upright[0] * upright
    length = float(np.linalg.norm(level))
    level = level / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])  # the camera lies on its side
    ahead = np.cross(upright, level)
    ahead /= max(float(np.hypot(*ahead[:2])), 0.3)  # seen at a slant, what lies ahead is shortened
    turns = np.stack([exp_so3(turn * upright) for turn in (0.0, -const.TRY_RAD, const.TRY_RAD)])
    steps = np.stack(
        [x * level + y * ahead for x in (0.0, -const.TRY_PX, const.TRY_PX) for y in (0.0, -const.TRY_PX, const.TRY_PX)]
    )
    poses, nats = first.poses.copy(), np.full(len(first.nats), -np.inf)
    for number in np.unique(first.templates):
        rows = np.nonzero(first.templates == number)[0]
        tried = np.tile(first.poses[rows], (len(turns), len(steps), 1, 1, 1))
        tried[..., :3, :3] = turns[:, None, None] @ tried[..., :3, :3]
        metres = first.poses[rows, 2, 3] / intrinsics[0]
        tried[..., :3, 3] += metres[:, None] * steps[:, None]
        template = sweep["templates"][number]
        found = _nats(maps.near, tried, template["controls"], intrinsics)
        every = tried.reshape(-1, 4, 4) @ invert(template["pose"])
        found += _stands_out(maps.colours, every, sides[number], intrinsics).reshape(found.shape)
        best = found.argmax(axis=0)
        poses[rows], nats[rows] = tried.reshape(-1, len(rows), 4, 4)[best, np.arange(len(rows))], found.max(axis=0)
    order = np.argsort(-nats, kind="stable")
    closer = Proposed(poses[order], first.templates[order], nats[order])
    return only(closer, np.array(_apart(closer, intrinsics), dtype=np.intp))


def _nats(maps: Singles, tried: Floats, controls: ControlPoints, intrinsics: Array) -> Floats:
    """(t * s, n) what one template's control points say of poses (t, s, n, 4, 4), in each of t turns n of them, and the
    same a little beside, s in all."""
    if not len(controls["points"]):
        return np.full((tried.shape[0] * tried.shape[1], tried.shape[2]), -np.inf)
    fx, fy, cx, cy = (np.float32(part) for part in intrinsics)
    points, tangents = (controls[name].astype(np.float32).T for name in ("points", "tangents"))
    rotations, shifts = tried[:, 0, :, :3, :3].astype(np.float32), tried[..., :3, 3].astype(np.float32)
    turned = [rotations[..., axis, :] @ points for axis in range(3)]
    x, y, z = (turned[axis][:, None] + shifts[..., axis, None] for axis in range(3))
    np.divide(np.float32(1.0), np.maximum(z, np.float32(0.02), out=z), out=z)
    x *= z
    y *= z
    # Across the edge, not along it: the direction of the gradient, the same a little beside.
    tx, ty, tz = (rotations[..., axis, :] @ tangents for axis in range(3))
    turn = np.arctan2(fx * (tx - x[:, 0] * tz), -fy * (ty - y[:, 0] * tz))
    direction = np.rint(turn * np.float32(const.DIRECTIONS / np.pi)).astype(np.int32) % const.DIRECTIONS
    _, height, width = maps.shape
    columns = np.rint((x * fx + (cx - np.float32(0.5))) / const.SHRUNK).astype(np.int32)
    rows = np.rint((y * fy + (cy - np.float32(0.5))) / const.SHRUNK).astype(np.int32)
    outside = (columns < 0) | (columns >= width - 1) | (rows < 0) | (rows >= height - 1)
    at = (direction[:, None] * height + rows) * width + columns
    at[outside] = maps[0].size - 1
    total: Floats = maps.take(at).sum(axis=-1).astype(np.float64)
    return total.reshape(-1, total.shape[-1])


def _edges(small: Singles) -> tuple[NDArray[np.bool_], Singles]:
    """Where the gradient of the channel that changes most is strong, and as strong as anything before and behind it;
    and its direction, 0 to pi."""
    sobels = (cv2.Sobel(small, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1)))
    across, down = (part.reshape(small.shape) for part in sobels)
    strongest = (across * across + down * down).argmax(axis=2)[..., None]
    gx, gy = (np.take_along_axis(part, strongest, axis=2)[..., 0] for part in (across, down))
    least = const.SLOPE_PARTS * max(const.MAP_CONTRAST, const.MAP_SLOPES * float(np.median(np.hypot(gx, gy))))
    dx, dy = (np.rint(const.SLOPE_PARTS * part).astype(np.int16) for part in (gx, gy))
    edges: NDArray[np.bool_] = cv2.Canny(dx, dy, least, least, L2gradient=True) > 0
    return edges, (np.arctan2(gy, gx) % np.pi).astype(np.float32)


def _apart(found: Proposed, intrinsics: Array) -> list[int]:
    """Numbers of the first few poses, best first, that are apart from all better ones."""
    flat = found.poses[:, :3, 3] * (intrinsics[0] / found.poses[:, 2, 3])[:, None]
    kept: list[int] = []
    for number in range(len(flat)):
        near = np.linalg.norm(flat[kept] - flat[number], axis=1) < const.SWEPT_APART_PX
        if near.any():
            turned = np.einsum("nij,ij->n", found.poses[kept, :3, :3], found.poses[number, :3, :3])
            if (near & (turned > 1.0 + 2.0 * np.cos(const.SWEPT_APART_RAD))).any():
                continue
        kept.append(number)
        if len(kept) == const.GIVEN:
            break
    return kept
