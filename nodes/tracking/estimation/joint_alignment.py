"""All objects at once, each within what its prediction leaves open, with the camera's error as a common unknown.

Edges that are near one another move one another's peaks: blurred, two parallel edges a few pixels apart are one peak,
or two that are pulled together, as beside a face that is seen nearly edge-on, or where two objects meet. What is
matched there says little, and both edges would claim the same one in the image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.appearance import Memory, only_found
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.fusion import Fused, Known, Prior, fuse
from hierax.nodes.tracking.estimation.palette import palette_of
from hierax.nodes.tracking.estimation.profiles import Image
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.estimation.tracked import motion_of
from hierax.nodes.tracking.math.batched import exp_many, inverse, pixels_of, placed
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats
from hierax.nodes.tracking.model.controls import Controls, gathered
from hierax.nodes.tracking.model.symmetry import NONE, is_plain, open_to
from hierax.nodes.tracking.schema import TrackedObject

_NEAR = Search()
_CALM = Search(const.CALM_REACH_PX, const.CALM_SCALE_PX, const.CALM_ITERATIONS)


class Task(NamedTuple):
    """What is aligned."""

    image: Image  # of `hierax.nodes.tracking.estimation.profiles.smoothed`
    controls: Controls  # the control points of all objects
    memory: Memory  # what is remembered of them
    intrinsics: Array  # (4,) fx, fy, cx, cy in pixels
    start: Start  # where the objects are expected, with room for motion
    search: Search  # how the image is searched
    prior: Prior  # what is known before it
    palette: Floats | None  # of `hierax.nodes.tracking.estimation.palette.palette_of`: what the objects' colours tell


class Explained(NamedTuple):
    """What the image says, and what it says together with the prediction."""

    aligned: Aligned
    fused: Fused


def task_of(image: Image, objects: Sequence[TrackedObject], prior: Prior, intrinsics: Array) -> Task:
    """What is to be aligned, as `hierax.nodes.tracking.search.association.associate` is told it; prior: of
    `prior_of`."""
    controls = gathered([item["controls"] for item in objects])
    # The light on what moves changes.
    known = [item["slots"] if item["motion_scale"] < const.FREEDOM else only_found(item["slots"]) for item in objects]
    predicted = np.stack([item["pose"] for item in objects])
    memory = memory_of(known, controls, image.shape[2])
    memory = memory._replace(apart=apartness(controls, predicted, intrinsics).astype(np.float32))
    free = prior._replace(motion_scale=np.maximum(prior.motion_scale, const.FREEDOM))
    calm = (
        float(free.motion_scale.max()) <= const.FREEDOM
        and float(prior.covariance[:, :3, :3].max()) < const.SETTLED_M**2
    )
    near = _CALM if calm else _NEAR
    symmetries = [item.get("symmetry", NONE) for item in objects]
    told = None if all(map(is_plain, symmetries)) else np.stack([open_to(each) for each in symmetries])
    start = Start(predicted, inverse(free.spread()), prior.camera, told)
    palette = palette_of(image, [item["slots"] for item in objects])
    return Task(image, controls, memory, intrinsics, start, near, prior, palette)


def prior_of(objects: Sequence[TrackedObject], motion: Floats, known: Known | None) -> Prior:
    """What is known before an image; motion: (6, 6) or (m, 6, 6) covariance of an object's deviation from its
    prediction within a frame, when it is pushed; known: of all together; None: the camera's pose is exact."""
    covariance = np.stack([item["covariance"] for item in objects])
    motion_scale = np.array([_with_motion(item) for item in objects])
    trend = np.array([item["trend"] for item in objects])
    return Prior(covariance, motion, motion_scale, trend, *(known or Known()))


def explained(task: Task) -> Explained | None:
    """The poses of all objects, and the camera's error; None where no control point is in the image."""
    return _from(task, exp_many(task.prior.shift[None])[0])


def explained_again(task: Task, before: Explained, doubtful: Sequence[int]) -> Explained | None:
    """The same from where the camera's error puts the objects, when it is large and some are in doubt: far from its
    edges an object may have taken others; what the rest of them says of the camera brings it near. None where that is
    no better."""
    if task.prior.joint is None or not doubtful:
        return None
    begun, shift = exp_many(np.stack((task.prior.shift, before.fused.shift)))
    jumps = flat((shift @ task.start.poses)[doubtful]) - flat((begun @ task.start.poses)[doubtful])
    if np.abs(jumps * task.intrinsics[:2]).max() < const.JUMP_PX:
        return None
    again = _from(task, shift)
    if again is None or (again.aligned.gains - before.aligned.gains)[doubtful].sum() <= 0.0:
        return None
    return again


def _from(task: Task, shift: Floats) -> Explained | None:
    """What is surprising of an object at rest is only believed where resting explains the image clearly less well."""
    prior = task.prior
    free = _aligned(task, task.start.information, shift)
    if free is None:
        return None
    fused = fuse(free, prior)
    held = (fused.motion_scale == 1.0) & (prior.motion_scale < const.AT_REST)
    calm = inverse(prior.spread())
    for _ in range(2):  # all of them, then those alone of which resting explains enough
        information = np.where(held[:, None, None], calm, task.start.information)
        tried = _aligned(task, information, shift) if held.any() else None
        if tried is None:
            break
        enough = held & (tried.gains >= free.gains - const.RESTING_MARGIN * free.shown)
        if (enough == held).all():
            return Explained(tried, fuse(tried, prior, held))
        held = enough
    return Explained(free, fused)


def _aligned(task: Task, information: Floats, shift: Floats) -> Aligned | None:
    """What the image says of the poses, with information (m, 6, 6) of the predictions, and a shift (4, 4) that the
    camera's error is supposed to be for all poses."""
    start = task.start._replace(poses=shift @ task.start.poses, information=information)
    found = align(task.image, task.controls, start, task.intrinsics, task.memory, task.search)
    return None if found is None else found._replace(shift=found.shift @ shift)


def flat(poses: Floats) -> Floats:
    """(n, 2) where the origins of poses (n, 4, 4) are in the image, in focal lengths from its centre."""
    return np.asarray(poses[:, :2, 3] / np.maximum(poses[:, 2:3, 3], NEAREST_M))


def _with_motion(item: TrackedObject) -> float:
    """How much an object that moves may change its motion: the faster it is, the more."""
    motion = motion_of(item)
    least = const.CHANGE_PER_M * float(np.linalg.norm(motion[:3])) + const.CHANGE_PER_RAD * float(
        np.linalg.norm(motion[3:])
    )
    return max(float(item["motion_scale"]), min(least, const.MOST_CHANGE))


def apartness(controls: Controls, poses: Floats, intrinsics: Array) -> Floats:
    """(n,) 0 to 1 of each control point of all objects how far its edge stands alone where poses (m, 4, 4),
    camera_from_object, put it."""
    if not len(controls.owners):
        return np.zeros(0)
    seen = placed(poses, controls.owners, controls.points)
    depth, pixels = np.maximum(seen[:, 2], NEAREST_M), pixels_of(seen, intrinsics)
    first = np.nonzero(np.diff(controls.numbers, prepend=-1))[0]
    last = np.append(first[1:], len(pixels)) - 1
    # Each edge as the line from its first control point to its last.
    length = np.hypot(*(pixels[last] - pixels[first]).T)
    along = (pixels[last] - pixels[first]) / np.maximum(length, 1e-9)[:, None]
    own = np.repeat(np.arange(len(first)), last - first + 1)
    away = pixels[:, None] - pixels[first]
    place = away[..., 0] * along[:, 0] + away[..., 1] * along[:, 1]
    distance = np.abs(away[..., 0] * along[:, 1] - away[..., 1] * along[:, 0])
    beside = (place > -const.BEYOND_PX) & (place < length + const.BEYOND_PX) & (distance < const.CROWD_PX)
    beside &= (np.abs(along @ along.T) > const.PARALLEL)[own]
    beside[np.arange(len(own)), own] = False
    rows, edges = np.nonzero(beside)
    there = depth[first] + (depth[last] - depth[first]) * np.clip(place / np.maximum(length, 1e-9), 0.0, 1.0)
    same = (distance[rows, edges] < const.SAME_PX) & (np.abs(there[rows, edges] / depth[rows] - 1.0) < const.SAME_DEPTH)
    seen_there = np.add.reduceat(controls.visible, first) / (last - first + 1)
    pull = seen_there[edges] * (1.0 - (distance[rows, edges] / const.CROWD_PX) ** 2)
    pulled = np.zeros(len(own))
    np.maximum.at(pulled, rows, np.where(same, 0.0, pull))
    return np.asarray(1.0 - np.clip(pulled, 0.0, 1.0))
