"""Where a body that nobody has seen yet may be: poses in which it can rest, at places all over the camera's view.

Mental imagery proposes, the image decides. A place is a frame in the world, its z upwards and its x away from the
camera; a template is a pose of the body there, with the control points that would be seen of it. What is seen of a body
hardly depends on the place then, so that one template serves all places."""

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.imagery.physics import support_points
from hierax.nodes.tracking.math.batched import only
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, invert, looking_down, make_pose, rays, transform
from hierax.nodes.tracking.model.shapes import Shape
from hierax.nodes.tracking.model.symmetry import NONE, alike
from hierax.nodes.tracking.schema import Alternative, Size, Symmetry


class Proposer:
    """Proposes poses of one body, by the renderer of its shape; the templates that it keeps are a cache."""

    def __init__(self, renderer: LayerRenderer, symmetry: Symmetry = NONE) -> None:
        self.renderer = renderer
        self.resting = resting_poses(renderer.shape, symmetry)
        corners = outermost(renderer.shape.vertices)
        tops = {round(float(transform(pose, corners)[:, 2].max()), 4) for pose in self.resting}
        self.heights = sorted(tops)  # of the body where it rests, m
        self._templates: dict[tuple[float, ...], tuple[Alternative, ...]] = {}

    def templates(self, camera: Floats, middle: Floats, intrinsics: Array) -> tuple[Alternative, ...]:
        """The body's poses at a place (place_from_object), as the camera (world_from_camera; fx, fy, cx, cy in pixels)
        sees them there; middle: (3,) of the places."""
        away = camera[:3, 3] - middle
        distance = float(np.linalg.norm(away))
        elevation = round(float(np.arcsin(away[2] / distance)) / const.ELEVATION_RAD)
        key = (elevation, round(float(np.log(distance) / np.log(const.DISTANCE))), *intrinsics.tolist())
        if key not in self._templates:
            view = looking_down(np.pi, key[0] * const.ELEVATION_RAD, const.DISTANCE ** key[1], np.zeros(3))
            self._templates = dict(list(self._templates.items())[-3:])
            self._templates[key] = tuple(self._template(pose, view, intrinsics) for pose in self.resting)
        return self._templates[key]

    def _template(self, pose: Floats, view: Floats, intrinsics: Array) -> Alternative:
        # It is looked at in the middle, wherever the camera's own middle is.
        half = np.maximum(intrinsics[2:], const.TEMPLATE_HALF * intrinsics[:2])
        across, down = (int(2.0 * each / const.TEMPLATE_SHRUNK) + 1 for each in half)
        size = (across, down)
        seen, lens = invert(view) @ pose, np.concatenate((intrinsics[:2], half)) / const.TEMPLATE_SHRUNK
        renderer = self.renderer
        layer = None if renderer.shape.convex else renderer.layer(seen, lens, size)
        controls = controls_of(renderer.shape, seen, lens, size, layer)
        count = len(controls.points)
        few = only(controls, np.arange(0, count, max(1, -(-count // const.TEMPLATE_POINTS))))
        return {"pose": pose, "controls": few.sent(few.visible.astype(np.float32)), "kept": False}


def resting_poses(shape: Shape, symmetry: Symmetry = NONE) -> list[Floats]:
    """Poses (place_from_object) of a body that stands at a place, turned about the vertical; those that look alike
    once."""
    is_round = len(symmetry["free"]) > 0
    corners = outermost(shape.vertices)
    diameter = float(np.linalg.norm(np.ptp(corners, axis=0)))
    kept: list[Floats] = []
    seen = np.zeros((0, *corners.shape))
    for down in stable_faces(corners, _centre(shape)):
        upright = _turned_down(down)
        low, high = (corners @ upright.T).min(axis=0), (corners @ upright.T).max(axis=0)
        standing = make_pose(upright, -np.array([*(low + high)[:2] / 2.0, low[2]]))
        for turn in np.arange(const.YAWS) * 2.0 * np.pi / const.YAWS:
            pose = make_pose(exp_so3(np.array([0.0, 0.0, turn])), np.zeros(3)) @ standing
            placed = transform(pose, corners)
            if is_round and kept:  # the hull has corners where the body has none
                turned = [transform(alike(symmetry, pose[None], other)[0], corners) for other in kept]
                apart = np.linalg.norm(seen - np.stack(turned), axis=-1).max(axis=1)
            else:
                apart = np.linalg.norm(seen[:, :, None] - placed[None, None], axis=-1).min(axis=1).max(axis=1)
            if (apart > const.SAME_POSE * diameter).all():
                kept.append(pose)
                seen = np.concatenate((seen, placed[None]))
    return kept


def outermost(vertices: Floats) -> Floats:
    """(n, 3) those of a body's vertices that faces on which it may rest are looked for between."""
    return vertices if len(vertices) <= const.HULL_CORNERS else support_points(vertices, const.HULL_CORNERS)


def stable_faces(corners: Floats, centre: Floats) -> list[Floats]:
    """Unit vectors downwards, object's frame, at which a body rests on a face of its convex hull, the lowest first, by
    the hull's corners (n, 3) and the centre of mass (3,). What is too thin to rest steadily, as a pencil, rests on
    those faces on which it would not fall over; what would on each, on the lowest."""
    diameter = float(np.linalg.norm(np.ptp(corners, axis=0)))
    trios = corners[np.array(list(combinations(range(len(corners)), 3)))]
    normals = np.cross(trios[:, 1] - trios[:, 0], trios[:, 2] - trios[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    flat = areas > 1e-4 * diameter**2
    normals = normals[flat] / areas[flat, None]
    heights = np.einsum("tk,nk->tn", normals, corners) - np.einsum("tk,tk->t", normals, trios[flat, 0])[:, None]
    below, above = heights.max(axis=1) < 0.5 * const.FLAT * diameter, heights.min(axis=1) > -0.5 * const.FLAT * diameter
    outward = np.concatenate((normals[below], -normals[above]))
    ordered = list(outward[np.argsort((outward @ corners.T).max(axis=1) - outward @ centre, kind="stable")])
    for least in (const.STEADY * diameter, 0.0):
        faces: list[Floats] = []
        for down in ordered:
            if any(float(down @ other) > 0.999 for other in faces) or len(faces) == const.MOST_FACES:
                continue
            if _steadiness(corners, centre, down, const.FLAT * diameter) > least:
                faces.append(down)
        if faces:
            return faces
    return ordered[:1]


def places_on(
    camera: Floats, intrinsics: Array, size: Size, height: float, outline: Floats | None, most: int, turn: int = 0
) -> Floats:
    """Places (n, 4, 4), world_from_place, on a level plane at a height, m, evenly over what the camera
    (world_from_camera; fx, fy, cx, cy in pixels; (w, h) of the image) sees of it. outline: (k, 2) the corners of the
    part of it that is meant, m; None for all of it. most: places, about; turn: others give other places, between
    those."""
    step = max(const.STEP_PX, int(np.sqrt(size[0] * size[1] / max(most, 1))))
    across, down = (
        np.arange(step * (turn * part % 1.0), end, step) for part, end in zip(const.PHASES, size, strict=True)
    )
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    directions = rays(pixels, intrinsics) @ camera[:3, :3].T
    drop = camera[2, 3] - height
    middle = camera[2, 2]
    below = directions[:, 2] < -1e-3
    reach = np.where(below, drop / np.maximum(-directions[:, 2], 1e-3), np.inf)
    farthest = const.FARTHEST * drop / -middle if middle < -1e-3 else np.inf
    points = (camera[:3, 3] + reach[:, None] * directions)[below & (reach > 0.0) & (reach < farthest)]
    if outline is not None and len(points):
        hull = cv2.convexHull(outline.astype(np.float32))
        within = [cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in points[:, :2]]
        points = points[np.array(within)]
    away = points[:, :2] - camera[:2, 3]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    places = np.tile(np.eye(4), (len(points), 1, 1))
    places[:, :2, 0] = away
    places[:, 0, 1], places[:, 1, 1] = -away[:, 1], away[:, 0]
    places[:, :3, 3] = points
    places[:, 2, 3] = height
    return places


def places_seen(
    camera: Floats, intrinsics: Array, size: Size, heights: Sequence[float], templates: int, turn: int = 0
) -> Floats:
    """Places (n, 4, 4) on planes of those heights all over the image, as for `places_on`; templates: how many poses are
    tried at each place."""
    most = const.BUDGET // max(templates * len(heights), 1)
    return np.concatenate([places_on(camera, intrinsics, size, height, None, most, turn) for height in heights])


def places_at(
    camera: Floats, intrinsics: Array, size: Size, faces: Sequence[Floats], templates: int, turn: int = 0
) -> Floats:
    """Places (n, 4, 4) on level faces, each the (k, 3) corners of one, world's frame, as for `places_seen`."""
    found = [
        places_on(camera, intrinsics, size, float(face[:, 2].max()), face[:, :2], const.BUDGET, turn) for face in faces
    ]
    every = np.concatenate((np.zeros((0, 4, 4)), *found))
    thinned = max(1, -(-len(every) * templates // const.BUDGET))
    return every[turn % thinned :: thinned]


def top_of(corners: Floats) -> Floats:
    """Those (k, 3) of a body's corners (n, 3), world's frame, that lie as high as the highest; none where they are no
    face."""
    top = corners[corners[:, 2] > corners[:, 2].max() - const.LEVEL_M]
    spread = np.ptp(top[:, :2], axis=0) if len(top) > 2 else np.zeros(2)
    found: Floats = top if spread.min() > 0.01 else top[:0]
    return found


def bottom_of(corners: Floats) -> Floats:
    """Likewise of those that lie as low as the lowest."""
    return top_of(corners * [1.0, 1.0, -1.0]) * [1.0, 1.0, -1.0]


def _centre(shape: Shape) -> Floats:
    """The centre of what a closed surface holds; of other ones, of the bounding box."""
    middle: Floats = 0.5 * (shape.low + shape.high)
    if not shape.closed.all():
        return middle
    corners = shape.vertices[shape.faces] - middle
    volumes = np.einsum("mk,mk->m", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    middle += np.einsum("m,mk->k", volumes, corners.sum(axis=1)) / (4.0 * max(float(volumes.sum()), 1e-12))
    return middle


def _turned_down(down: Floats) -> Floats:
    """(3, 3) a rotation that turns a unit vector downwards."""
    other = np.eye(3)[np.abs(down).argmin()]
    first = np.cross(other, -down)
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(-down, first), -down))


def _steadiness(corners: Floats, centre: Floats, down: Floats, flat_m: float) -> float:
    """How far inside its foot a body's centre is, m."""
    turned, middle = corners @ _turned_down(down).T, _turned_down(down) @ centre
    foot = turned[turned[:, 2] < turned[:, 2].min() + flat_m, :2] - middle[:2]
    hull = cv2.convexHull((1000.0 * foot).astype(np.float32))
    return float(cv2.pointPolygonTest(hull, (0.0, 0.0), True)) / 1000.0
