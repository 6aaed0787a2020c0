"""What a tracking node believes as messages of ROS: for bags and for live topics alike."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.ros2.messages import NS, TRANSFORMS, made
from hierax.nodes.sources.shots import Floats, Header
from hierax.nodes.tracking.math.geometry import quaternion_of
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED

WORLD, CAMERA = "world", "camera"  # frame ids; the camera's is the optical one, x right, y down, z forward
DIAGNOSTICS, DETECTIONS = "diagnostic_msgs/msg/DiagnosticArray", "vision_msgs/msg/Detection3DArray"
MARKERS, POSE = "visualization_msgs/msg/MarkerArray", "geometry_msgs/msg/PoseStamped"
OK, WARN = 0, 1
_LEVELS = {TRACKED: OK, EXPECTED: WARN, LOST: 2}
_FIGURES = ("score", "probability", "nats")
_TRIANGLES, _ADD = 11, 0
_COLOUR = {"r": 0.2, "g": 0.7, "b": 0.3, "a": 0.6}

Message = tuple[str, str, Any]  # topic, which begins with a slash where it is everybody's; type; and the message


class Tracked(NamedTuple):
    """What a node believes of an object."""

    id: int
    obj_id: int
    pose: Floats  # camera_from_object
    covariance: Floats  # of a twist in the object's frame
    status: str
    figures: Mapping[str, float]

    @property
    def frame(self) -> str:
        """The name of the object's frame."""
        return f"object_{self.id}"


def tracked(belief: Mapping[str, Any]) -> tuple[Floats | None, list[Tracked]]:
    """Where an arm of tracking believes the camera, world_from_camera, and the objects to be. Raises LookupError,
    TypeError, ValueError or OverflowError: it is none's belief."""
    camera = None if belief["camera"] is None else _matrix(belief["camera"], 4)
    return camera, [
        Tracked(
            int(item["id"]),
            int(item.get("obj_id", item["id"])),
            _matrix(item["pose"], 4),
            _matrix(item.get("covariance", np.zeros((6, 6))), 6),
            str(item["status"]),
            {name: float(item[name]) for name in _FIGURES if name in item},
        )
        for item in belief["objects"]
    ]


def messages_of(
    header: Header, objects: Sequence[Tracked], placed: Mapping[tuple[str, str], Floats | None]
) -> Iterator[Message]:
    """Poses, detections and transforms of the objects that are not lost, in the camera's frame, which the header names.

    Args: placed: further transforms, by the frame and its child's, frame_from_child."""
    stamp_ns, frame = header["stamp_ns"], header["frame_id"]
    known = [item for item in objects if item.status != LOST]
    for item in known:
        yield f"{item.frame}/pose", POSE, made(POSE, header=stamped(**header), pose=_pose(item.pose))
    detections = [_detection(header, item) for item in known]
    yield "detections", DETECTIONS, made(DETECTIONS, header=stamped(**header), detections=detections)
    poses = {**placed, **{(frame, item.frame): item.pose for item in known}}
    yield "/tf", TRANSFORMS, made(TRANSFORMS, transforms=[_transform(stamp_ns, *at) for at in poses.items()])


def diagnosed(stamp_ns: int, node: str, objects: Sequence[Tracked], more: Sequence[Any] = ()) -> Message:
    """What is known of each object, and more statuses in front."""
    each = [
        status(_LEVELS.get(item.status, 3), f"{node}: object {item.id}", item.status, item.frame, item.figures)
        for item in objects
    ]
    return "/diagnostics", DIAGNOSTICS, made(DIAGNOSTICS, header=stamped(stamp_ns, ""), status=[*more, *each])


def status(level: int, name: str, message: str, hardware: str, figures: Mapping[str, float]) -> Any:
    """A `DiagnosticStatus`."""
    values = [made("diagnostic_msgs/msg/KeyValue", key=key, value=repr(each)) for key, each in figures.items()]
    kind = "diagnostic_msgs/msg/DiagnosticStatus"
    return made(kind, level=level, name=name, message=message, hardware_id=hardware, values=values)


def meshes(bodies: Sequence[Mapping[str, Any]]) -> Message:
    """The bodies' meshes, each in the frame of its object and locked to it: they are drawn wherever `/tf` has it."""
    markers = []
    for body in bodies:
        corners = np.asarray(body["model"]["vertices"])[np.asarray(body["model"]["faces"])].reshape(-1, 3)
        points = [_point("Point", corner) for corner in corners]
        kind = "visualization_msgs/msg/Marker"
        fields: dict[str, Any] = {"ns": "hierax", "id": int(body["id"]), "type": _TRIANGLES, "action": _ADD}
        fields |= {"pose": _pose(np.eye(4)), "scale": _point("Vector3", np.ones(3)), "points": points, "colors": []}
        fields |= {"color": made("std_msgs/msg/ColorRGBA", **_COLOUR), "lifetime": _time("Duration", 0)}
        fields |= {"frame_locked": True, "text": "", "mesh_resource": "", "mesh_use_embedded_materials": False}
        texture = made("sensor_msgs/msg/CompressedImage", header=stamped(0, ""), format="", data=np.zeros(0, np.uint8))
        mesh_file = made("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8))
        fields |= {"texture_resource": "", "texture": texture, "uv_coordinates": [], "mesh_file": mesh_file}
        markers.append(made(kind, header=stamped(0, f"object_{body['id']}"), **fields))
    return "markers", MARKERS, made(MARKERS, markers=markers)


def stamped(stamp_ns: int, frame_id: str) -> Any:
    """A message's header."""
    return made("std_msgs/msg/Header", stamp=_time("Time", stamp_ns), frame_id=frame_id)


def _time(kind: str, nanoseconds: int) -> Any:
    seconds, rest = divmod(nanoseconds, NS)
    return made(f"builtin_interfaces/msg/{kind}", sec=seconds, nanosec=rest)


def _matrix(value: Any, size: int) -> Floats:
    matrix = np.asarray(value, np.float64)
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        raise ValueError("no pose")
    return matrix


def _point(kind: str, numbers: Floats) -> Any:
    x, y, z = numbers.tolist()
    return made(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _turn(pose: Floats) -> Any:
    x, y, z, w = quaternion_of(pose[:3, :3]).tolist()
    return made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(pose: Floats) -> Any:
    return made("geometry_msgs/msg/Pose", position=_point("Point", pose[:3, 3]), orientation=_turn(pose))


def _transform(stamp_ns: int, frames: tuple[str, str], pose: Floats | None) -> Any:
    where = np.eye(4) if pose is None else pose
    moved = made("geometry_msgs/msg/Transform", translation=_point("Vector3", where[:3, 3]), rotation=_turn(where))
    header, child = stamped(stamp_ns, frames[0]), frames[1]
    return made("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=moved)


def _detection(header: Header, item: Tracked) -> Any:
    """As its class an object has its model's number; of its size the arm knows nothing."""
    turn = np.kron(np.eye(2), item.pose[:3, :3])
    covariance = (turn @ item.covariance @ turn.T).ravel()  # ROS has it along the axes of the header's frame
    pose = made("geometry_msgs/msg/PoseWithCovariance", pose=_pose(item.pose), covariance=covariance)
    score = item.figures.get("probability", item.figures.get("score", 0.0))
    named = made("vision_msgs/msg/ObjectHypothesis", class_id=str(item.obj_id), score=score)
    return made(
        "vision_msgs/msg/Detection3D",
        header=stamped(**header),
        results=[made("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=named, pose=pose)],
        bbox=made("vision_msgs/msg/BoundingBox3D", center=_pose(item.pose), size=_point("Vector3", np.zeros(3))),
        id=str(item.id),
    )
