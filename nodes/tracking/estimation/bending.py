"""Edges that are not where an object's model has them: imprecise models, bevels, worn edges.

Where each edge is beside the model's is part of the belief: a Gaussian in the object's frame, at first as wide as the
model's tolerance. It is learned from image to image, given the poses that all edges together have there; so what of an
object's pose cannot be told from a displacement of its model stays as it was when the object was seen first."""

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, offsets_at
from hierax.nodes.tracking.estimation.appearance import Memory, recalled
from hierax.nodes.tracking.estimation.stages import moves_of
from hierax.nodes.tracking.math.batched import found_among
from hierax.nodes.tracking.math.geometry import Array, Floats
from hierax.nodes.tracking.model.controls import Controls, Indices
from hierax.nodes.tracking.schema import ControlPoints, Looks


def bent(controls: ControlPoints, looks: Looks) -> ControlPoints:
    """One object's control points where its edges were found to be."""
    if looks["size"] != 1.0:
        controls = {**controls, "points": looks["size"] * controls["points"]}
    if not looks["tolerance"] or not len(looks["bent"]):
        return controls
    offsets = np.zeros((len(controls["edges"]), 3))
    known, place = _known(looks, controls["edges"])
    offsets[known] = looks["bends"][place]
    return {**controls, "points": controls["points"] + offsets}


def slack_of(objects: list[Looks], controls: Controls) -> Floats:
    """(n, 3, 3) covariance of how far the edge of each control point is beside where it was found to be, m²."""
    slack = np.zeros((len(controls.owners), 3, 3))
    for at, looks in enumerate(objects):
        if not looks["tolerance"]:
            continue
        rows = np.nonzero(controls.owners == at)[0]
        slack[rows] = looks["tolerance"] ** 2 * np.eye(3)
        known, place = _known(looks, controls.edges[rows])
        slack[rows[known]] = looks["slack"][place]
    return slack


def memory_of(objects: list[Looks], controls: Controls, channels: int) -> Memory:
    """The memory of all objects (by their index), laid beside the control points, and where their edges may be."""
    return recalled(objects, controls, channels)._replace(slack=slack_of(objects, controls))


def bent_after(looks: Looks, aligned: Aligned, at: int, pose: Floats, intrinsics: Array) -> Looks:
    """What is known of one object's edges after an image (a Kalman filter's update, edge by edge); at: which of the
    aligned objects it is; pose: (4, 4) camera_from_object, as it was found."""
    tolerance = looks["tolerance"]
    if not tolerance:
        return looks
    poses = aligned.poses.copy()
    poses[at] = pose
    stage = aligned.stage
    rows = np.nonzero(aligned.supported & (stage.controls.visible > 0.5) & (stage.controls.owners == at))[0]
    if not len(rows):
        return looks
    edges, starts, count = np.unique(stage.controls.edges[rows], return_index=True, return_counts=True)
    moves = moves_of(poses, stage.controls, stage.lines, rows, intrinsics)
    off = np.add.reduceat(offsets_at(aligned, poses)[rows], starts) / count
    mean = np.add.reduceat(moves, starts) / count[:, None]
    every = np.union1d(looks["bent"], edges)
    before, now = np.searchsorted(every, looks["bent"]), np.searchsorted(every, edges)
    bends = np.zeros((len(every), 3))
    slack = np.tile(tolerance**2 * np.eye(3), (len(every), 1, 1))
    bends[before], slack[before] = looks["bends"], looks["slack"]
    spread = slack[now]
    carried = np.einsum("eij,ej->ei", spread, mean)
    variance = np.einsum("ei,ei->e", mean, carried) + const.WHOLE_PX**2 + const.NOISE_PX**2 / count
    gain = carried / variance[:, None]
    bends[now] += gain * off[:, None]
    slack[now] = spread - gain[:, :, None] * carried[:, None, :]
    return {**looks, "bent": every, "bends": bends, "slack": slack}


def _known(looks: Looks, edges: Array) -> tuple[Indices, Indices]:
    """Which of some edges are known, and where among the known ones."""
    if not len(looks["bent"]):
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    known, place = found_among(looks["bent"], edges)
    return np.nonzero(known)[0], place[known]
