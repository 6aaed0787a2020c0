"""What the nodes of a tracking deployment show: `hierax view`.

The views: ``camera``, the image with edges as they were expected (red) and as the correction puts them (green);
``imagined``, the depth image with labels that the spatial node expects; ``scene``, the camera and the bodies at their
poses; ``error_mm`` and ``turn_deg`` against the truth, where the world knows it; ``scores``, ``probability`` and
``nats`` of the arm's objects; ``evidence``, the image with edges coloured by what they say, and ``why`` in words."""

from collections.abc import Mapping, Sequence

import numpy as np

from hierax.nodes.tracking import schema
from hierax.nodes.tracking.evaluation.pictures import CORRECTED, EXPECTED, edges_seen
from hierax.nodes.tracking.evidence import Evidence, Sought, evidence, sought
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats, Size, invert, pose_error, project
from hierax.nodes.tracking.model.symmetry import NONE, alike
from hierax.nodes.tracking.render import DepthRenderer, item_of
from hierax.runtime import Step, Value
from hierax.runtime.core import showing

_FRUSTUM_M = 0.12
_COARSER = 4  # the image is drawn in the scene, too, and small there: of `_COARSER` pixels one, in each direction
_TRUE_M = 0.06
_EXPECTED_PX, _CORRECTED_PX = 3.5, 1.5  # widths: where both are at one place, both are seen
_GRID_M, _GRID_STEP_M = 0.4, 0.1
_LOST = (120, 120, 120)
# What edges of at least so many nats are called and drawn as; what is left is as little as the one in the middle.
_SHARES = (
    (2.0, "for", (40, 200, 80)),
    (0.3, "rather for", (170, 220, 90)),
    (-0.3, "says little", (170, 170, 170)),
    (-2.0, "rather against", (250, 170, 40)),
    (-np.inf, "against", (230, 50, 50)),
)
_EDGE_PX, _OTHER_PX = 3.0, 1.0
_OTHERS = 3  # so many of an object's other poses are drawn
_GRID = (170, 170, 170)

_renderer = DepthRenderer()  # a cache of the bodies' meshes, prepared


def world_things(step: Step) -> dict[str, showing.Thing]:
    """The true poses of the bodies, where the world knows them, as axes."""
    return {f"/scene/true/{body['id']}": showing.Axes(body["pose"], _TRUE_M) for body in step.sensed.get("bodies", ())}


def arm_things(step: Step, before: Value, motion: Floats) -> dict[str, showing.Thing]:
    """The image with edges, the camera in the scene, the objects' scores, and the evidence for their poses; before:
    what the arm expected, the red edges, if there are any; motion: (6, 6) covariance of how far an object may leave its
    prediction within a frame, when it is pushed."""
    corrected = step.sensed
    objects = corrected["objects"]
    things: dict[str, showing.Thing] = {
        f"/{view}/{item['id']}": _curve(item["id"], item[name])
        for item in objects
        for view, name in (("scores", "score"), ("probability", "probability"), ("nats", "nats"))
    }
    if not step.observations or corrected["camera"] is None:
        return things
    image, intrinsics = step.observations[0]["image"], corrected["intrinsics"]
    things["/camera/image"] = showing.Image(image)
    if before is not None and before["camera"] is not None:
        moved = invert(corrected["camera"]) @ before["camera"]
        lines = edges_seen(before["objects"], moved, intrinsics)
        things["/camera/expected"] = showing.Lines2D(lines, EXPECTED, _EXPECTED_PX)
    tracked = [item for item in objects if item["status"] == schema.TRACKED]
    things["/camera/corrected"] = showing.Lines2D(edges_seen(tracked, np.eye(4), intrinsics), CORRECTED, _CORRECTED_PX)
    things.update(_names(objects, intrinsics, corrected["size"]))
    lens, small = np.asarray(intrinsics) / _COARSER, image[::_COARSER, ::_COARSER]
    size = (corrected["size"][0] // _COARSER, corrected["size"][1] // _COARSER)
    things["/scene/camera"] = showing.Camera(corrected["camera"], lens, size, small, depth_m=_FRUSTUM_M)
    told = evidence(image, corrected, before, step.belief, motion)
    lost = sought(image, corrected, step.belief)
    return {**things, **_evidence_things(told, lost, image, intrinsics)}


def _evidence_things(
    told: Sequence[Evidence], lost: Sequence[Sought], image: Array, intrinsics: Array
) -> dict[str, showing.Thing]:
    """The image with edges coloured by what they say, thin outlines of other poses, and of those at which objects may
    be that are looked for, and all of it in words."""
    every: Sequence[Evidence | Sought] = [*told, *lost]
    if not every:
        return {}
    things: dict[str, showing.Thing] = {
        "why": "\n\n".join(each.text() for each in every),
        "/evidence/image": showing.Image(image),
    }
    dashes: dict[str, list[Floats]] = {}
    for edge in (edge for each in told for edge in each.edges):
        name = next(name for least, name, _ in _SHARES if edge.nats >= least)
        dashes.setdefault(name, []).append(edge.dashes)
    for each in every:
        for number, other in enumerate(each.others[:_OTHERS]):
            there: schema.TrackedObject = {**each.item, "pose": other.pose, "edges": other.edges}
            lines = edges_seen([there], np.eye(4), intrinsics)
            path = f"/evidence/instead/{each.item['id']}/{number}"
            things[path] = showing.Lines2D(lines, showing.colour_of(each.item["id"]), _OTHER_PX)
    for _, name, colour in _SHARES:
        if name in dashes:
            things[f"/evidence/{name}"] = showing.Lines2D(np.concatenate(dashes[name]), colour, _EDGE_PX)
    return things


def spatial_things(step: Step, table_m: Floats | None) -> dict[str, showing.Thing]:
    """The bodies where they are expected, and what the camera is expected to see of them; the plane z = 0, where it
    carries the bodies, as a grid around its middle (3,), m."""
    belief = step.belief
    things: dict[str, showing.Thing] = {}
    if table_m is not None:
        things["/scene/table"] = showing.Lines3D(_grid() + table_m, _GRID, 0.0005)
    for body in belief["bodies"]:
        colour = _LOST if body["status"] == schema.LOST else showing.colour_of(body["id"])
        model = body["model"]
        things[f"/scene/bodies/{body['id']}"] = showing.Mesh(model["vertices"], model["faces"], body["pose"], colour)
    if belief["camera"] is None:
        return things
    items = [item_of(body, invert(belief["camera"])) for body in belief["bodies"]]
    depth, labels = _renderer.render(items, belief["intrinsics"], belief["size"])
    return {**things, "/imagined/depth": showing.Depth(depth), "/imagined/labels": showing.Labels(labels)}


def errors(steps: Mapping[str, Step]) -> dict[str, showing.Thing]:
    """How far the arm's poses are from the truth, seen from the camera, where the world knows it, by an epoch's steps
    of all nodes: of each tracked object ``/error_mm/ID`` and ``/turn_deg/ID``."""
    worlds = [step.sensed for step in steps.values() if not step.observations and "bodies" in step.sensed]
    arms = [step.sensed for step in steps.values() if "objects" in step.sensed]
    truth = {body["id"]: invert(world["camera"]) @ body["pose"] for world in worlds for body in world["bodies"]}
    things: dict[str, showing.Thing] = {}
    for item in (item for arm in arms for item in arm["objects"]):
        number = item["id"]
        if item["status"] == schema.TRACKED and number in truth:
            (nearest,) = alike(item.get("symmetry", NONE), item["pose"][None], truth[number])
            distance_m, angle_rad = pose_error(nearest, truth[number])
            things[f"/error_mm/{number}"] = _curve(number, 1000.0 * distance_m)
            things[f"/turn_deg/{number}"] = _curve(number, float(np.degrees(angle_rad)))
    return things


def _curve(number: int, value: float) -> showing.Curve:
    return showing.Curve(value, showing.colour_of(number))


def _names(
    objects: Sequence[schema.TrackedObject | schema.PaperObject], intrinsics: Array, size: Size
) -> dict[str, showing.Thing]:
    """At its origin, if that is in the picture, what an object is that is not tracked."""
    things: dict[str, showing.Thing] = {}
    for item in objects:
        origin = np.asarray(item["pose"])[:3, 3]
        if item["status"] == schema.TRACKED or origin[2] <= NEAREST_M:
            continue
        at = project(origin[None], intrinsics)
        if bool(((at >= 0.0) & (at < size)).all()):
            name = f"{item['id']} {item['status']}"
            things[f"/camera/names/{item['id']}"] = showing.Points2D(at, showing.WHITE, 3.0, (name,))
    return things


def _grid() -> Floats:
    """Lines of the plane z = 0, (n, 2, 3) metres."""
    at = np.arange(-_GRID_M, _GRID_M + _GRID_STEP_M / 2, _GRID_STEP_M)
    along = [[[x, -_GRID_M, 0.0], [x, _GRID_M, 0.0]] for x in at]
    across = [[[-_GRID_M, y, 0.0], [_GRID_M, y, 0.0]] for y in at]
    return np.array(along + across)
