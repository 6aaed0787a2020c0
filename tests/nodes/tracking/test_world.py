"""One deployment for both worlds, and the three nodes together in the formal core."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.arm import poses_seen
from hierax.nodes.tracking.datasets.bop_world import BopWorld
from hierax.nodes.tracking.math.geometry import Floats, invert, pose_error
from hierax.nodes.tracking.model.files import BOP_UNIT_M, write_ply
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.simworld.world import SCENE, SimWorld
from hierax.nodes.tracking.world import arm, seen, spatial, world
from hierax.runtime import Tick
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, prediction_update, sensing_update, update
from hierax.schemas.values import encode_value

SEED = 4


def hierarchy(context: bool = True, scene: str | None = None, **options: Any) -> Hierarchy:
    edges = [
        Edge("world", "arm", sense=seen),
        Edge("arm", "spatial", sense=poses_seen, context=SegmentedDepth() if context else None),
    ]
    nodes = {"world": world(scene, **options), "arm": arm(scene), "spatial": spatial(scene)}
    return Hierarchy(nodes, "world", edges, OperatorSetting(seed=SEED))


def run(of: Hierarchy, epochs: int) -> tuple[list[Any], list[Any]]:
    """The world's beliefs at the epochs' starts, and the arm's after its observations."""
    active = ActiveHierarchy.initial(of)
    truth, sensed = [], []
    for epoch in range(1, epochs + 1):
        truth.append(active.states["world"].belief)
        time_s = of.world_node.time_s(truth[-1], epoch)
        for name in of.order:
            active = sensing_update(active, name, epoch, time_s)
        sensed.append(active.states["arm"].belief)
        for name in reversed(of.order):
            active = prediction_update(active, name, epoch, time_s)
    return truth, sensed


def test_with_context_all_cubes_are_tracked_to_a_few_millimetres() -> None:
    truth, sensed = run(hierarchy(), 60)
    for belief, arm_belief in zip(truth[1:], sensed[1:], strict=True):
        camera_from_world = invert(belief["camera"])
        for body, item in zip(belief["bodies"], arm_belief["objects"], strict=True):
            where = f"seed {SEED}, frame {belief['frame']}, object {item['id']}"
            distance, angle = pose_error(item["pose"], camera_from_world @ body["pose"])
            assert item["status"] == "tracked", where
            assert distance < 0.005, where
            assert angle < np.radians(4.0), where


def test_without_context_all_cubes_are_lost() -> None:
    _, sensed = run(hierarchy(context=False), 5)
    assert {item["status"] for item in sensed[-1]["objects"]} == {"lost"}


def test_two_runs_have_equal_beliefs_to_the_bit() -> None:
    states = []
    for _ in range(2):
        active = ActiveHierarchy.initial(hierarchy())
        encoded = []
        for _ in range(8):
            active = update(active)
            encoded.append({name: encode_value(state.belief) for name, state in active.states.items()})
        states.append(encoded)
    assert states[0] == states[1]


def test_the_nodes_of_a_simulation_begin_with_its_first_frame() -> None:
    belief = SimWorld(cubes=3).initial_belief()
    bodies = spatial(cubes=3).initial_belief()["bodies"]
    objects = arm(cubes=3).initial_belief()["objects"]
    for true, body, item, placed in zip(belief["bodies"], bodies, objects, SCENE, strict=False):
        np.testing.assert_allclose(body["pose"], true["pose"], atol=1e-12)
        np.testing.assert_allclose(belief["camera"] @ item["pose"], true["pose"], atol=1e-12)
        np.testing.assert_allclose(np.ptp(body["model"]["vertices"], axis=0), placed.side_m)
        assert body["id"] == item["id"] == true["id"]
    assert len(bodies) == len(objects) == 3


def test_the_arm_is_given_no_shapes() -> None:
    for item in arm().initial_belief()["objects"]:
        assert "model" not in item
        assert len(item["edges"]) == 0


@pytest.fixture
def scene(tmp_path: Path) -> str:
    """Pictures of the simulated world as a BOP scene folder; the truth of frame 0 alone."""
    folder = tmp_path / "cubes" / "test" / "000007"
    (folder / "rgb").mkdir(parents=True)
    (tmp_path / "cubes" / "models").mkdir()
    simulated = SimWorld(cubes=3)
    belief = simulated.initial_belief()
    cameras: dict[str, Any] = {}
    objects = [
        {"obj_id": body["obj_id"], **_bop_pose(invert(belief["camera"]) @ body["pose"], "m2c")}
        for body in belief["bodies"]
    ]
    for _ in range(4):
        (element,) = seen(belief, Tick(seed=SEED, epoch=belief["frame"]))
        cv2.imwrite(str(folder / "rgb" / f"{belief['frame']:06d}.png"), element["image"][..., ::-1])
        fx, fy, cx, cy = element["intrinsics"]
        matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        cameras[str(belief["frame"])] = {"cam_K": matrix, **_bop_pose(invert(belief["camera"]), "w2c")}
        belief = simulated.predict((), (), belief)
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    (folder / "scene_gt.json").write_text(json.dumps({"0": objects}))
    info: dict[str, Any] = {}
    for number, placed in enumerate(SCENE[:3], start=1):
        write_ply(tmp_path / "cubes" / "models" / f"obj_{number:06d}.ply", box_mesh([placed.side_m] * 3))
        info[str(number)] = {"diameter": placed.side_m * 3**0.5 / BOP_UNIT_M}
    (tmp_path / "cubes" / "models" / "models_info.json").write_text(json.dumps(info))
    return str(folder)


def _bop_pose(pose: Floats, name: str) -> dict[str, list[float]]:
    return {
        f"cam_R_{name}": pose[:3, :3].ravel().tolist(),
        f"cam_t_{name}": (pose[:3, 3] / BOP_UNIT_M).tolist(),
    }


def test_a_scene_folder_is_tracked_like_the_simulation_it_shows(scene: str) -> None:
    """Without a table the bodies float; three frames are tracked all the same."""
    _, sensed = run(hierarchy(scene=scene), 4)
    truth = SimWorld(cubes=3).initial_belief()
    for frame, belief in enumerate(sensed):
        assert belief["frame"] == frame
        for body, item in zip(truth["bodies"], belief["objects"], strict=True):
            distance, angle = pose_error(belief["camera"] @ item["pose"], body["pose"])
            assert item["status"] == ("tracked" if frame else "expected")
            assert distance < 0.004
            assert angle < np.radians(2.0)


def test_a_scene_folder_ends_the_run(scene: str) -> None:
    of = world(scene)
    assert isinstance(of, BopWorld)
    belief = of.initial_belief()
    frames = 0
    while not of.finished(belief):
        assert len(seen(belief)) == 1
        belief = of.predict((), (), belief)
        frames += 1
    assert frames == 4


def test_only_the_simulated_world_has_a_table_by_itself(scene: str) -> None:
    for of, settles in ((spatial(), True), (spatial(scene), False), (spatial(scene, table=True), True)):
        belief = of.initial_belief()
        raised = tuple({**body, "pose": _raised(body["pose"])} for body in belief["bodies"])
        after = of.predict((), (), {**belief, "bodies": raised})
        falls = [
            body["pose"][2, 3] < before["pose"][2, 3] for body, before in zip(after["bodies"], raised, strict=True)
        ]
        assert any(falls) == settles


def _raised(pose: Floats) -> Floats:
    raised = pose.copy()
    raised[2, 3] += 0.5
    return raised


def test_a_missing_scene_is_named() -> None:
    for build in (world, arm, spatial):
        with pytest.raises(DataError, match="nowhere/000001"):
            build("nowhere/000001")
