"""What the nodes exchange is what the schema says, over some frames of the simulated world."""

from __future__ import annotations

from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.datasets.bop_world import BopWorld
from hierax.nodes.tracking.paper.arm import PaperArmNode
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.schema import (
    ArmBelief,
    Imagery,
    PaperArmBelief,
    Picture,
    SeenCamera,
    SeenObject,
    SimBelief,
    SpatialBelief,
    fault,
)
from hierax.nodes.tracking.simworld.world import SimWorld
from hierax.nodes.tracking.spatial import SpatialNode
from hierax.nodes.tracking.world import arm, seen, spatial, world
from hierax.runtime import Tick

FRAMES = 5


def tick(epoch: int) -> Tick:
    return Tick(epoch=epoch, time_s=epoch / 30.0)


@pytest.mark.parametrize(("method", "kind"), [("robust", ArmBelief), ("paper", PaperArmBelief)])
def test_beliefs_observations_and_context_are_as_the_schema_says(method: str, kind: Any) -> None:
    simulated, tracker, imagery = world(frames=FRAMES), arm(method=method), spatial()
    assert isinstance(tracker, ArmNode | PaperArmNode)
    imagined = SegmentedDepth()
    beliefs: list[Any] = [simulated.initial_belief(), tracker.initial_belief(), imagery.initial_belief()]
    for epoch in range(1, FRAMES + 1):
        for belief, schema in zip(beliefs, (SimBelief, kind, SpatialBelief), strict=True):
            assert fault(belief, schema, "belief") == "", f"epoch {epoch}"
        pictures = seen(beliefs[0], tick(epoch))
        beliefs[1] = tracker.observe(pictures, beliefs[1])
        objects = poses_seen(beliefs[1])
        beliefs[2] = imagery.predict((), (), imagery.observe(objects, beliefs[2], tick(epoch)))
        context = imagined(beliefs[2])
        beliefs[1] = tracker.predict(context, (), beliefs[1])
        beliefs[0] = simulated.predict((), (), beliefs[0])
        assert [fault(each, Picture, "picture") for each in pictures] == [""]
        assert [fault(each, SeenObject, "object") for each in objects[:-1]] == [""] * 6
        assert fault(objects[-1], SeenCamera, "camera") == ""
        assert [fault(each, Imagery, "imagery") for each in context] == [""]


@pytest.mark.parametrize("each", [ArmNode, PaperArmNode, SpatialNode, SimWorld, BopWorld, SegmentedDepth])
def test_whatever_a_node_is_given_or_gives_has_a_type(each: type) -> None:
    operators = [
        vars(each)[name] for name in ("initial_belief", "observe", "predict", "__call__") if name in vars(each)
    ]
    for operator in (*operators, seen, poses_seen):
        for name, kind in get_type_hints(operator).items():
            assert kind is not Any, (operator, name)
            assert Any not in get_args(kind), (operator, name)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"camera": np.eye(3)}, "picture.camera: expected the shape (4, 4)"),
        ({"camera": np.eye(4, dtype=np.float32)}, "picture.camera: expected an array of float64"),
        ({"frame": 1.5}, "picture.frame: expected int, got float"),
        ({"frame": True}, "picture.frame: expected int, got bool"),
        ({"motion": 1}, "expected a map with the keys ['camera', 'frame', 'image', 'intrinsics']"),
    ],
)
def test_what_is_not_as_the_schema_says_is_named(change: dict[str, Any], told: str) -> None:
    picture = {"image": np.zeros((4, 4), np.uint8), "camera": np.eye(4), "intrinsics": np.ones(4), "frame": 1}
    assert fault(picture, Picture, "picture") == ""
    assert told in fault({**picture, **change}, Picture, "picture")
