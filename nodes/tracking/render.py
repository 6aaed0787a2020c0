"""What the spatial node expects its camera to see: each object as if nothing hid it, and all of them together.

An image depends on the arguments alone, to the bit; what a renderer keeps from one to the next is a cache."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking import schema
from hierax.nodes.tracking.errors import check_between
from hierax.nodes.tracking.estimation.tracked import NO_CONTROLS
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.imagery.layers import Layer, LayerRenderer, Window, surrounding
from hierax.nodes.tracking.imagery.occlusion import Placed, chances_seen
from hierax.nodes.tracking.imagery.proposals import Proposer, bottom_of, places_at, places_seen, top_of
from hierax.nodes.tracking.math.batched import only
from hierax.nodes.tracking.math.geometry import Array, Floats, Size, invert, transform
from hierax.nodes.tracking.model.controls import Controls, gathered
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.model.symmetry import NONE
from hierax.nodes.tracking.schema import LOST, TRACKED, Alternative, Body, ControlPoints, SpatialBelief


class Item(NamedTuple):
    """One object to draw."""

    label: int  # 1 to 255, unique in the image
    vertices: Floats  # (n, 3) float64, metres, object's frame
    faces: Array  # (m, 3) int, indices of vertices, counter-clockwise seen from outside
    pose: Floats  # camera_from_object


class _Scene(NamedTuple):
    """What a camera is expected to see: the bodies, each as it is drawn, and what is drawn of those that are there."""

    camera_from_world: Floats
    intrinsics: Array
    size: Size
    bodies: Sequence[Body]
    items: Sequence[Item]
    layers: Mapping[int, Layer]


class DepthRenderer:
    """Draws labelled depth; keeps the meshes, prepared, from one image to the next."""

    def __init__(self) -> None:
        self._held: dict[int, tuple[Item, LayerRenderer]] = {}

    def layers(self, items: Sequence[Item], intrinsics: Array, size: Size) -> dict[int, Layer]:
        """Each item alone, by its label, in the order of labels, without those that cannot be in the image (width,
        height) of a camera (fx, fy, cx, cy in pixels, pixel centres at integers). Raises ValueError: labels are doubled
        or out of range."""
        ordered = sorted(items, key=lambda item: item.label)
        labels = [item.label for item in ordered]
        if len(set(labels)) != len(labels) or not all(1 <= label <= 255 for label in labels):
            raise ValueError(f"labels must be different and from 1 to 255, got {labels}")
        found = {item.label: self.renderer(item).layer(item.pose, intrinsics, size) for item in ordered}
        return {label: layer for label, layer in found.items() if layer is not None}

    def render(self, items: Sequence[Item], intrinsics: Array, size: Size) -> tuple[Array, Array]:
        """What a pinhole camera sees of the items: depth (h, w) float32, z in the camera's frame in metres, and labels
        (h, w) uint8, both 0 where nothing is. Raises ValueError: labels are doubled or out of range."""
        return composed(self.layers(items, intrinsics, size), Window(0, 0, *size))

    def renderer(self, item: Item) -> LayerRenderer:
        """What draws the item alone; made anew where its mesh is another one."""
        if item.label in self._held:
            held, renderer = self._held[item.label]
            if _same(held.vertices, item.vertices) and _same(held.faces, item.faces):
                return renderer
        made = LayerRenderer(shape_of(item.vertices, item.faces))
        self._held[item.label] = item, made
        return made


def composed(layers: Mapping[int, Layer], window: Window) -> tuple[Array, Array]:
    """What is seen of layers, by label, in a part of the image that holds all of their windows: depth and labels as
    `DepthRenderer.render` has them; of two at one depth, the first."""
    width, height = window.size
    nearest = np.zeros((height, width))
    labels = np.zeros((height, width), dtype=np.uint8)
    for label, layer in layers.items():
        own = layer.window
        view = np.s_[own.top - window.top : own.bottom - window.top, own.left - window.left : own.right - window.left]
        nearer = layer.inverse > nearest[view]
        np.copyto(nearest[view], layer.inverse, where=nearer)
        labels[view][nearer] = label
    depth = np.zeros((height, width), dtype=np.float32)
    np.divide(1.0, nearest, out=depth, where=nearest > 0.0, casting="same_kind")
    return depth, labels


class SegmentedDepth:
    """ϱ of the spatial node: the scene that it expects, as a depth image and a label image (theory, example 3). An edge
    function with a renderer of its own, which is only a cache. Without `occlusion` each body's controls are those of
    its own model, as if it were alone. The bodies' edges are expected to be worn round by `edge_radius_mm`."""

    def __init__(self, occlusion: bool = True, edge_radius_mm: float = 0.0) -> None:
        check_between(0, 10, "millimetres", edge_radius_mm=edge_radius_mm)
        self._radius_m = edge_radius_mm / 1000.0
        self._renderer = DepthRenderer()
        self._proposers: dict[int, Proposer] = {}
        self._occlusion = occlusion

    def __call__(self, belief: SpatialBelief) -> tuple[schema.Imagery, ...]:
        """The part of the image that holds all bodies, and of each body the control points whose chance to be seen is
        at least `LEAST_CHANCE`: one element, or none before the camera is known."""
        camera, intrinsics, size = belief["camera"], belief["intrinsics"], belief["size"]
        if camera is None or intrinsics is None or size is None:
            return ()
        bodies, camera_from_world = belief["bodies"], invert(camera)
        items = [item_of(body, camera_from_world) for body in bodies]
        missing = {body["id"] for body in bodies if is_missing(body, belief)}
        layers = self._renderer.layers([item for item in items if item.label not in missing], intrinsics, size)
        scene = _Scene(camera_from_world, intrinsics, size, bodies, items, layers)
        controls = self._controls(scene, missing)
        others = [self._others(scene, number) for number in range(len(bodies))]
        window = surrounding([layer.window for layer in layers.values()])
        depth, labels = composed(layers, window)
        imagery: schema.Imagery = {
            "depth": depth,
            "labels": labels,
            "camera": camera,
            "intrinsics": intrinsics - np.array([0.0, 0.0, window.left, window.top]),
            "corner": (window.left, window.top),
            "size": size,
            "poses": tuple(map(_expected, bodies, controls, others)),
            "sweeps": self._sweeps(belief, camera, intrinsics, size),
        }
        return (imagery,)

    def _sweeps(
        self, belief: SpatialBelief, camera: Floats, intrinsics: Array, size: Size
    ) -> tuple[schema.Sweep, ...] | None:
        """Where the bodies that are looked for everywhere may be: on the table, and on what stands there."""
        if belief["sweeping"] is None:
            return None
        found: list[schema.Sweep] = []
        for body in belief["bodies"]:
            if body["id"] in belief["sweeping"]:
                renderer = self._renderer.renderer(item_of(body, camera))
                proposer = self._proposers.get(body["id"])
                if proposer is None or proposer.renderer is not renderer:
                    proposer = self._proposers[body["id"]] = Proposer(renderer, body["model"].get("symmetry", NONE))
                if not proposer.resting:  # it is no body: all its corners lie in a line
                    continue
                # One that nobody knows may carry it: in turns with the table, heights are tried that others reach.
                heights = _heights(belief, body) if body["turn"] % 2 == 0 < body["turn"] else []
                turn, count = body["turn"], len(proposer.resting)
                rough_m = const.ROUGH_HEIGHT * heights[0] if heights else 0.0
                faces = [*_tops(belief, body), *_under(belief, proposer)]
                for places, off_m in (
                    (places_seen(camera, intrinsics, size, heights or [0.0], count, turn), rough_m),
                    (places_at(camera, intrinsics, size, faces, count, turn), 0.0),
                ):
                    if len(places):
                        middle = places[:, :3, 3].mean(axis=0) * [1.0, 1.0, 0.0]
                        templates = proposer.templates(camera, middle, intrinsics)
                        found.append({"id": body["id"], "places": places, "templates": templates, "rough_m": off_m})
        return tuple(found)

    def _controls(self, scene: _Scene, missing: Collection[int]) -> list[ControlPoints]:
        """The fields of each body's `Controls` that are likely enough to be seen."""
        placed = [_placed(scene, number) for number in range(len(scene.items))]
        view = (scene.intrinsics, scene.size)
        alone = [
            gathered([NO_CONTROLS])
            if item.label in missing
            else controls_of(self._renderer.renderer(item).shape, item.pose, *view, each.layer, self._radius_m)
            for item, each in zip(scene.items, placed, strict=True)
        ]
        chances = self._chances([controls.points for controls in alone], placed, scene.intrinsics)
        return [_likely(controls, seen) for controls, seen in zip(alone, chances, strict=True)]

    def _chances(self, points: list[Floats], placed: list[Placed], intrinsics: Array) -> list[NDArray[np.float32]]:
        """Of each point the chance that no body hides it."""
        if self._occlusion:
            return chances_seen(points, placed, intrinsics)
        return [np.ones(len(own), dtype=np.float32) for own in points]

    def _others(self, scene: _Scene, number: int) -> tuple[Alternative, ...]:
        """A body's other poses, each with the controls that it would have there."""
        body, intrinsics, size = scene.bodies[number], scene.intrinsics, scene.size
        if not len(body["others"]):
            return ()
        renderer = self._renderer.renderer(scene.items[number])
        poses = [scene.camera_from_world @ pose for pose in body["others"]]
        hollow = not renderer.shape.convex
        layers = [renderer.layer(pose, intrinsics, size) if hollow else None for pose in poses]
        views = zip(poses, layers, strict=True)
        alone = [controls_of(renderer.shape, pose, intrinsics, size, layer, self._radius_m) for pose, layer in views]
        hiders = [_placed(scene, other) for other in range(len(scene.items)) if other != number]
        near = const.OTHERS_SHARE * np.asarray(body["covariance"], dtype=np.float64)
        placed = [*hiders, *(Placed(pose, near, None) for pose in poses)]
        points = [np.zeros((0, 3))] * len(hiders) + [controls.points for controls in alone]
        chances = self._chances(points, placed, intrinsics)[len(hiders) :]
        return tuple(
            {"pose": pose, "controls": _likely(controls, seen), "kept": place < body["kept"]}
            for place, (pose, controls, seen) in enumerate(zip(body["others"], alone, chances, strict=True))
        )


def _placed(scene: _Scene, number: int) -> Placed:
    """A body for what may be behind it."""
    item, covariance = scene.items[number], scene.bodies[number]["covariance"]
    return Placed(item.pose, np.asarray(covariance, dtype=np.float64), scene.layers.get(item.label))


def is_missing(body: Body, belief: SpatialBelief) -> bool:
    """Whether nobody knows where a body is: it carries nothing, hides nothing, and is looked for everywhere."""
    return belief["sweeping"] is not None and body["status"] == LOST


def _tops(belief: SpatialBelief, body: Body) -> list[Floats]:
    """The upper faces of what stands, (k, 3) corners in the world's frame, on which a body may be; after long, also
    those of another missing body there, lying on any side: it may show so little that what is on it has to be found
    first."""
    standing = [other for other in belief["bodies"] if other["stands"] and other["status"] == TRACKED]
    tops = [top_of(transform(other["pose"], other["model"]["vertices"])) for other in standing]
    tops = [top for top in tops if len(top)]
    if body["turn"] <= const.COVERED_AFTER:
        return tops
    missing = [other for other in belief["bodies"] if other is not body and is_missing(other, belief)]
    sides = {round(float(side), 3) for other in missing for side in np.ptp(other["model"]["vertices"], axis=0)}
    return tops + [top + np.array([0.0, 0.0, side]) for top in tops for side in sorted(sides)]


def _under(belief: SpatialBelief, proposer: Proposer) -> list[Floats]:
    """Where a missing body may stand below what is seen where nothing known carries it: of each such body its lower
    face, (k, 3) corners in the world's frame, by the missing one's heights lower."""
    hanging = [other for other in belief["bodies"] if other["hangs"] and other["status"] == TRACKED]
    lower = [bottom_of(transform(other["pose"], other["model"]["vertices"])) for other in hanging]
    drops = [(face, height) for face in lower if len(face) for height in proposer.heights]
    return [face - [0.0, 0.0, height] for face, height in drops if face[:, 2].min() > height - const.LIES_M]


def _heights(belief: SpatialBelief, body: Body) -> list[float]:
    """About how high one or two of the others would carry a body, m."""
    others = [np.ptp(other["model"]["vertices"], axis=0).min() for other in belief["bodies"] if other is not body]
    share = 1.0 - const.LOWER * (body["turn"] // 2 % 2)
    return [float(number * share * np.mean(others)) for number in range(1, 1 + min(2, len(others)))]


def _likely(controls: Controls, seen: Array) -> ControlPoints:
    kept = seen >= const.LEAST_CHANCE
    return only(controls, kept).sent(seen[kept])


def _expected(body: Body, controls: ControlPoints, others: tuple[Alternative, ...]) -> schema.ExpectedObject:
    expected: schema.ExpectedObject = {
        "id": body["id"],
        "obj_id": body["obj_id"],
        "pose": body["pose"],
        "covariance": body["covariance"],
        "status": body["status"],
        "support": body["support"],
        "stands": body["stands"],
        "hangs": body["hangs"],
        "controls": controls,
        "others": others,
    }
    return {**expected, **schema.looking_alike(body["model"])}


def item_of(body: Body, camera_from_world: Floats) -> Item:
    """A body as it is drawn."""
    model = body["model"]
    return Item(body["id"], model["vertices"], model["faces"], camera_from_world @ body["pose"])


def _same(first: Array, second: Array) -> bool:
    return first is second or np.array_equal(first, second)
