"""One deployment for all worlds: simulated cubes, a scene folder in the BOP format, or a camera.

Each function takes ``scene``, the path of the folder, and ``objects``, a file that tells of the objects before a
camera, see `hierax.nodes.tracking.datasets.objects`; with neither the world is the simulated one. What the nodes may
know at the start is settled here: both get the objects' first poses, the spatial node their models too, the arm none.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hierax.nodes.sources.camera import CameraWorld, knows_camera, tells_pose
from hierax.nodes.sources.camera import picture_seen as picture_of_camera
from hierax.nodes.sources.shots import CameraBelief
from hierax.nodes.tracking.arm import ArmNode
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.datasets.bop_world import BopWorld, frame_seen
from hierax.nodes.tracking.datasets.objects import WORLD, read_objects
from hierax.nodes.tracking.datasets.tag import FAMILY, locate, tag_camera, tag_of
from hierax.nodes.tracking.math.geometry import Floats, invert
from hierax.nodes.tracking.model.mesh import Mesh, box_mesh
from hierax.nodes.tracking.model.symmetry import NONE, found_symmetry, model_of
from hierax.nodes.tracking.paper.arm import PaperArmNode
from hierax.nodes.tracking.schema import FirstBody, FirstPose, Picture, SceneBelief, SimBelief, Symmetry
from hierax.nodes.tracking.simworld.world import SCENE, SimWorld, camera_at, first_bodies, picture_seen
from hierax.nodes.tracking.spatial import SpatialNode
from hierax.runtime import NO_TICK, Tick, World

GIVEN, SEARCH = "given", "search"  # whether first poses are told, or looked for
_ARMS: dict[str, type[ArmNode] | type[PaperArmNode]] = {"robust": ArmNode, "paper": PaperArmNode}


def world(
    scene: str | None = None,
    cubes: int = len(SCENE),
    frames: int = 60,
    noise: float = 2.0,
    blur_px: float = 0.7,
    fps: float = 30.0,
    tag_mm: float | None = None,
    tag: str = FAMILY,
    camera: str | int | None = None,
    calibration: str | None = None,
    objects: str | None = None,
    source_timeout: float = 5.0,
    reopen: bool = False,
    camera_topic: str | None = None,
) -> World:
    """N₀: a `BopWorld` where a scene is given, a `CameraWorld` where a camera is, else a `SimWorld`.

    Args: scene: folder of a BOP scene, or None; cubes, frames, noise, blur_px: of the simulated world. fps: frames per
        second, of all but live cameras; tag_mm, tag: of a scene folder or a camera: side of a tag on the table that
        tells where the camera is, None for none; and which, see `tag_of`. camera, calibration, source_timeout, reopen:
        as for `CameraWorld`, and objects, which tells its pose; camera_topic: its `topic`.
    Raises DataError: a file of the scene is missing or damaged. ValueError: a number is out of its range, a tag is told
        for the simulated world, or there is something that goes with a camera alone, or lacks there.
    """
    found = tag_of(tag_mm, tag)
    _check_world(scene, camera, calibration, objects, camera_topic)
    if camera is not None and objects is not None:
        told = read_objects(Path(objects))
        by = f"tag_mm is {tag_mm}" if found is not None else f"camera is {camera}" if tells_pose(camera) else ""
        if by and (told.camera is not None or told.mixed):
            what = "the camera's pose, or poses in the camera's and in the world's frame"
            raise ValueError(f"{by}, and {objects} tells {what}; expected one of the two, in one frame")
        if found is not None and tells_pose(camera):
            raise ValueError(f"tag_mm is {tag_mm}, and camera is {camera}; expected one of the two to tell its pose")
        pose = None if told.camera is None else told.camera.tolist()
        tagged = None if found is None else partial(locate, found)
        return CameraWorld(camera, calibration, fps, source_timeout, reopen, pose, tagged, camera_topic)
    if scene is not None:
        return BopWorld(scene, fps, found)
    if found is not None:
        raise ValueError(f"tag_mm is {tag_mm}; expected it with a scene folder or a camera alone")
    return SimWorld(cubes=cubes, frames=frames, noise=noise, blur_px=blur_px, fps=fps)


def seen(belief: SceneBelief | SimBelief | CameraBelief, tick: Tick = NO_TICK) -> tuple[Picture, ...]:
    """φ of each world: what the camera sees."""
    if "ended" in belief:
        return picture_of_camera(belief)
    return frame_seen(belief) if "scene" in belief else picture_seen(belief, tick)


def arm(
    scene: str | None = None,
    cubes: int = len(SCENE),
    method: str = "robust",
    prior: bool = True,
    model_tolerance_mm: float | None = None,
    start: str = GIVEN,
    objects: str | None = None,
    **options: Any,
) -> ArmNode | PaperArmNode:
    """The arm node with the objects' first poses and nothing of their shapes.

    Args:
        scene, cubes, objects: as for `world`.
        method: how images correct poses: ``robust`` or, by line segments and solvePnP, ``paper``.
        prior, model_tolerance_mm: as for `ArmNode`, where the method has them.
        start: ``given``: first poses are those of the simulated world or of the folder's first frame; ``search``: they
            are looked for.
        options: further ones of `ArmNode` or `PaperArmNode`.

    Raises ValueError: there is no such method."""
    if method not in _ARMS:
        raise ValueError(f"method is {method!r}; expected one of {', '.join(_ARMS)}")
    if method != "robust" and start == SEARCH:
        raise ValueError(
            f"start is search, method {method}; expected the method robust with it: the other one needs poses"
        )
    if method == "robust":
        options |= {"prior": prior, "model_tolerance_mm": model_tolerance_mm}
    if objects is not None and read_objects(Path(objects)).frame == WORLD:
        options["camera"] = np.eye(4)
    return _ARMS[method](_first_objects(scene, cubes, start, objects)[0], **options)


def spatial(
    scene: str | None = None,
    cubes: int = len(SCENE),
    table: bool | None = None,
    physics: bool = True,
    start: str = GIVEN,
    tag_mm: float | None = None,
    tag: str = FAMILY,
    objects: str | None = None,
    **options: Any,
) -> SpatialNode:
    """The spatial node with the objects' first poses and their models.

    Args:
        scene, cubes, objects: as for `world`.
        table: whether the world's plane z = 0 carries the objects; None for yes in the
            simulated world, no elsewhere, where nobody says which way is up.
        physics: false for constant velocities in any case, without gravity and contacts.
        start: as for `arm`; tag_mm, tag: as for `world`.
        options: further ones of `SpatialNode`.

    Raises ValueError: objects are to be looked for without a table on which they could rest."""
    simulated = scene is None and objects is None
    carried = (simulated if table is None else table) and physics
    first, camera = _first_objects(scene, cubes, start, objects)
    found = tag_of(tag_mm, tag)
    if scene is not None and found is not None:
        camera = tag_camera(scene, found).first()
    if not carried and any(item["pose"] is None for item in first):
        raise ValueError("a first pose is not told; expected table=true with it: bodies are looked for as they rest")
    placed: list[FirstBody] = [
        {**item, "pose": None if item["pose"] is None else camera @ item["pose"], "model": model_of(mesh, symmetry)}
        for item, (mesh, symmetry) in zip(first, _models(scene, first, objects, found is not None), strict=True)
    ]
    return SpatialNode(placed, table=carried, **options)


def _check_world(
    scene: str | None, camera: str | int | None, calibration: str | None, objects: str | None, topic: str | None
) -> None:
    if camera is None:
        given = (("calibration", calibration), ("objects", objects), ("camera_topic", topic))
        alone = next((name for name, each in given if each), None)
        if alone:
            raise ValueError(f"{alone} is given and camera is not; expected it with a camera alone")
    elif scene is not None:
        raise ValueError(f"scene is {scene} and camera is {camera}; expected one of the two")
    elif objects is None:
        raise ValueError(f"camera is {camera} and objects is not given; expected a file that tells what is tracked")
    elif calibration is None and not knows_camera(camera, topic):
        raise ValueError(f"camera is {camera} and calibration is not given; expected a file, see hierax calibrate")


def _first_objects(
    scene: str | None, cubes: int, start: str, objects: str | None
) -> tuple[Sequence[FirstPose], Floats]:
    """``id``, ``obj_id`` and ``pose`` of all objects in the first frame; world_from_frame of the poses' frame, mostly
    the camera's."""
    if start not in (GIVEN, SEARCH):
        raise ValueError(f"start is {start!r}; expected {GIVEN} or {SEARCH}")
    if objects is not None:
        told = read_objects(Path(objects))
        unknown: list[FirstPose] = [{**item, "pose": None} for item in told.objects]
        return told.objects if start == GIVEN else unknown, told.world_from_frame
    if scene is not None:
        folder = BopScene(scene)
        found = [_first_pose(*item) for item in folder.first_objects(poses=start == GIVEN)]
        return found, folder.frames[0].camera
    camera = camera_at(0.0)
    poses = [(body["id"], body["obj_id"], invert(camera) @ body["pose"]) for body in first_bodies(cubes)]
    return [_first_pose(number, obj_id, pose if start == GIVEN else None) for number, obj_id, pose in poses], camera


def _first_pose(number: int, obj_id: int, pose: Floats | None) -> FirstPose:
    return {"id": number, "obj_id": obj_id, "pose": pose}


def _models(
    scene: str | None, first: Sequence[FirstPose], objects: str | None, tagged: bool
) -> list[tuple[Mesh, Symmetry]]:
    if objects is not None:
        return read_objects(Path(objects)).read_models(tagged)
    if scene is not None:
        folder = BopScene(scene)
        return [folder.model(item["obj_id"], item["pose"] is not None) for item in first]
    meshes = [box_mesh([SCENE[item["obj_id"] - 1].side_m] * 3) for item in first]
    told = [item["pose"] is not None for item in first]  # how a cube lies is told by its first pose alone
    return [(mesh, NONE if each else found_symmetry(mesh)) for mesh, each in zip(meshes, told, strict=True)]
