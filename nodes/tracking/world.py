"""One deployment for both worlds: simulated cubes, or a scene folder of photographs in the BOP format.

Each function takes ``scene``: None for the simulated world, else the path of the folder. What the nodes may know at the
start is settled here: both get the objects' first poses, the spatial node their models too, the arm none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hierax.nodes.tracking.arm import ArmNode
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.datasets.bop_world import BopWorld, frame_seen
from hierax.nodes.tracking.datasets.tag import FAMILY, tag_camera, tag_of
from hierax.nodes.tracking.math.geometry import Floats, invert
from hierax.nodes.tracking.model.mesh import Mesh, box_mesh
from hierax.nodes.tracking.model.symmetry import NONE, model_of
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
) -> World:
    """N₀: a `BopWorld` where a scene is given, else a `SimWorld`.

    Args: scene: folder of a BOP scene, or None; cubes, frames, noise, blur_px: of the simulated world. fps: frames per
        second, of either; tag_mm, tag: of a scene folder: side of a tag on the table that tells where the camera is,
        None for none; and which, see `tag_of`.
    Raises DataError: a file of the scene is missing or damaged. ValueError: a number is out of its range, or a
        tag is told for the simulated world.
    """
    found = tag_of(tag_mm, tag)
    if scene is not None:
        return BopWorld(scene, fps, found)
    if found is not None:
        raise ValueError(f"tag_mm is {tag_mm}; expected it with a scene folder alone")
    return SimWorld(cubes=cubes, frames=frames, noise=noise, blur_px=blur_px, fps=fps)


def seen(belief: SceneBelief | SimBelief, tick: Tick = NO_TICK) -> tuple[Picture, ...]:
    """φ of either world: what the camera sees."""
    return frame_seen(belief) if "scene" in belief else picture_seen(belief, tick)


def arm(
    scene: str | None = None,
    cubes: int = len(SCENE),
    method: str = "robust",
    prior: bool = True,
    model_tolerance_mm: float | None = None,
    start: str = GIVEN,
    **options: Any,
) -> ArmNode | PaperArmNode:
    """The arm node with the objects' first poses and nothing of their shapes.

    Args:
        scene, cubes: as for `world`.
        method: how images correct poses: ``robust`` or, by line segments and solvePnP, ``paper``.
        prior, model_tolerance_mm: as for `ArmNode`, where the method has them.
        start: ``given``: first poses are those of the simulated world or of the folder's first frame; ``search``: they
            are looked for.
        options: further ones of `ArmNode` or `PaperArmNode`.

    Raises ValueError: there is no such method.
    """
    if method not in _ARMS:
        raise ValueError(f"method is {method!r}; expected one of {', '.join(_ARMS)}")
    if method != "robust" and start == SEARCH:
        raise ValueError(
            f"start is search, method {method}; expected the method robust with it: the other one needs poses"
        )
    if method == "robust":
        options |= {"prior": prior, "model_tolerance_mm": model_tolerance_mm}
    return _ARMS[method](_first_objects(scene, cubes, start)[0], **options)


def spatial(
    scene: str | None = None,
    cubes: int = len(SCENE),
    table: bool | None = None,
    physics: bool = True,
    start: str = GIVEN,
    tag_mm: float | None = None,
    tag: str = FAMILY,
    **options: Any,
) -> SpatialNode:
    """The spatial node with the objects' first poses and their models.

    Args:
        scene, cubes: as for `world`.
        table: whether the world's plane z = 0 carries the objects; None for yes in the
            simulated world, no in a scene folder, where nobody says which way is up.
        physics: false for constant velocities in any case, without gravity and contacts.
        start: as for `arm`; tag_mm, tag: as for `world`.
        options: further ones of `SpatialNode`.

    Raises ValueError: objects are to be looked for without a table on which they could rest.
    """
    carried = (scene is None if table is None else table) and physics
    objects, camera = _first_objects(scene, cubes, start)
    found = tag_of(tag_mm, tag)
    if scene is not None and found is not None:
        camera = tag_camera(scene, found).first()
    search = any(item["pose"] is None for item in objects)
    if search and not carried:
        raise ValueError("a first pose is not told; expected table=true with it: bodies are looked for as they rest")
    placed: list[FirstBody] = [
        {**item, "pose": None if item["pose"] is None else camera @ item["pose"], "model": model_of(mesh, symmetry)}
        for item, (mesh, symmetry) in zip(objects, _models(scene, objects), strict=True)
    ]
    return SpatialNode(placed, table=carried, search=search, **options)


def _first_objects(scene: str | None, cubes: int, start: str) -> tuple[list[FirstPose], Floats]:
    """``id``, ``obj_id`` and ``pose`` (camera_from_object) of all objects in the first frame; its world_from_camera."""
    if start not in (GIVEN, SEARCH):
        raise ValueError(f"start is {start!r}; expected {GIVEN} or {SEARCH}")
    if scene is not None:
        folder = BopScene(scene)
        found = [_first_pose(*item) for item in folder.first_objects(poses=start == GIVEN)]
        return found, folder.frames[0].camera
    camera = camera_at(0.0)
    poses = [(body["id"], body["obj_id"], invert(camera) @ body["pose"]) for body in first_bodies(cubes)]
    return [_first_pose(number, obj_id, pose if start == GIVEN else None) for number, obj_id, pose in poses], camera


def _first_pose(number: int, obj_id: int, pose: Floats | None) -> FirstPose:
    return {"id": number, "obj_id": obj_id, "pose": pose}


def _models(scene: str | None, objects: Sequence[FirstPose]) -> list[tuple[Mesh, Symmetry]]:
    if scene is not None:
        folder = BopScene(scene)
        return [folder.model(item["obj_id"]) for item in objects]
    return [(box_mesh([SCENE[item["obj_id"] - 1].side_m] * 3), NONE) for item in objects]  # to be told by first poses
