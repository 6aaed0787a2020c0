"""A whole episode, as the deployment has it, in the formal core: a cube is tracked, taken, lifted and held."""

from __future__ import annotations

import numpy as np
from support.launched import hierax, run_here

from hierax.nodes.picking.commands import handed_down
from hierax.nodes.picking.grasp import GraspNode, held_now
from hierax.nodes.picking.tracker import arm, poses_and_hand_seen, scene_known, spatial
from hierax.nodes.picking.world import PickWorld, picture_and_hand_seen
from hierax.nodes.tracking.math.geometry import invert, pose_error
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.schemas.values import encode_value

SEED = 1
SCENE = 1
CUBES = 2
EPOCHS = 240
ALIKE = 12


def hierarchy() -> Hierarchy:
    edges = [
        Edge("world", "arm", sense=picture_and_hand_seen, task=handed_down),
        Edge("arm", "spatial", sense=poses_and_hand_seen, task=handed_down, context=SegmentedDepth()),
        Edge("spatial", "grasp", sense=scene_known, task=handed_down, context=held_now),
    ]
    nodes = {
        "world": PickWorld(SCENE, CUBES, width=400, height=300),
        "arm": arm(SCENE, CUBES),
        "spatial": spatial(SCENE, CUBES),
        "grasp": GraspNode(),
    }
    return Hierarchy(nodes, "world", edges, OperatorSetting(seed=SEED))


def test_a_cube_is_picked_up() -> None:
    """When it begins to be lifted, other processes that begin with the same values go on alike, to the bit."""
    active = ActiveHierarchy.initial(hierarchy())
    world = active.hierarchy.world_node
    successors: ActiveHierarchy | None = None
    alike = 0
    phases: list[str] = []
    while not world.finished(active.states["world"].belief):
        assert active.epoch < EPOCHS, f"seed {SEED}, scene {SCENE}: {phases}"
        active = update(active)
        phase = active.states["grasp"].belief["phase"]
        if not phases or phases[-1] != phase:
            phases.append(phase)
        if phase != "lift" or alike > ALIKE:
            continue
        alike += 1
        successors = ActiveHierarchy(hierarchy(), active.states, active.epoch) if not successors else update(successors)
        for name, state in successors.states.items():
            assert encode_value(state.belief) == encode_value(active.states[name].belief), name
    assert alike > ALIKE
    metrics = world.metrics(active.states["world"].belief)
    assert phases == ["watch", "approach", "descend", "close", "lift", "hold"]
    assert metrics["grasped"] == 1.0
    assert metrics["held_s"] >= 2.0
    assert metrics["lift_mm"] > 100.0
    _is_tracked_in_the_hand(active)


def _is_tracked_in_the_hand(active: ActiveHierarchy) -> None:
    """The spatial node, which has never been told, knows where the cube that is held is before the camera."""
    truth, known = active.states["world"].belief, active.states["spatial"].belief
    number = active.states["grasp"].belief["target"]
    true = next(body["pose"] for body in truth["bodies"] if body["id"] == number)
    imagined = next(body["pose"] for body in known["bodies"] if body["id"] == number)
    distance, angle = pose_error(invert(known["camera"]) @ imagined, invert(truth["camera"]) @ true)
    assert distance < 0.002
    assert angle < np.radians(3.0)


def test_run_and_launch_give_the_same_digests() -> None:
    words = ["pick", "--set", "cubes=2", "--epochs", "3"]
    assert run_here(*words)["digest"] == hierax("launch", *words)["digest"]
