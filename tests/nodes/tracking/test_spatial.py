"""The spatial node: where it puts bodies, what it learns of their motion, and what physics may and may not correct."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.tracking.math.geometry import Floats, exp_se3, exp_so3, make_pose, pose_error
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.spatial import SpatialNode
from hierax.runtime import Tick
from hierax.schemas.values import decode_value, encode_value

SIDE_M = 0.06
MESH = box_mesh([SIDE_M] * 3)
MODEL = {"vertices": MESH.vertices, "faces": MESH.faces}
CERTAIN = np.diag([0.0005**2] * 3 + [0.005**2] * 3)
VAGUE = np.diag([0.05**2] * 3 + [0.5**2] * 3)
CAMERA = {
    "camera": make_pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.6])),
    "intrinsics": np.array([500.0, 500.0, 319.5, 239.5]),
    "size": (640, 480),
    "frame": 3,
}


def at(x: float = 0.0, y: float = 0.0, z: float = SIDE_M / 2, yaw: float = 0.0) -> Floats:
    return make_pose(exp_so3(np.array([0.0, 0.0, yaw])), np.array([x, y, z]))


def node(*poses: Floats, **options: Any) -> SpatialNode:
    objects = [{"id": i, "obj_id": 10 + i, "pose": pose, "model": MODEL} for i, pose in enumerate(poses, start=1)]
    return SpatialNode(objects, **options)


def sighting(
    pose: Floats, number: int = 1, status: str = "tracked", covariance: Floats = CERTAIN, sought: bool = False
) -> dict[str, Any]:
    return {
        "id": number,
        "obj_id": 10 + number,
        "pose": pose,
        "covariance": covariance,
        "score": 0.9,
        "status": status,
        "sought": sought,
        "guesses": np.zeros((0, 4, 4)),
    }


def follow(spatial: SpatialNode, poses: list[Floats], interval_s: float, status: str = "tracked") -> Any:
    """Epochs in which the one body is seen at these poses; the belief after the last `predict`."""
    belief = spatial.initial_belief()
    for epoch, pose in enumerate(poses):
        tick = Tick(epoch=epoch + 1, time_s=epoch * interval_s)
        belief = spatial.observe((sighting(pose, status=status), CAMERA), belief, tick)
        belief = spatial.predict((), (), belief)
    return belief


def test_before_the_first_observation_there_is_no_camera() -> None:
    belief = node(at()).initial_belief()
    assert belief["camera"] is None
    (body,) = belief["bodies"]
    assert body["status"] == "expected"
    np.testing.assert_array_equal(body["pose"], at())
    np.testing.assert_array_equal(body["velocity"], np.zeros(6))
    assert decode_value(encode_value(belief))["bodies"][0]["id"] == 1


def test_a_body_is_moved_to_where_the_arm_tracks_it_and_the_camera_is_kept() -> None:
    spatial = node(at())
    belief = spatial.observe((sighting(at(0.01)), CAMERA), spatial.initial_belief(), Tick(time_s=0.0))
    np.testing.assert_array_equal(belief["bodies"][0]["pose"], at(0.01))
    np.testing.assert_array_equal(belief["bodies"][0]["covariance"], CERTAIN)
    for name, value in CAMERA.items():
        np.testing.assert_array_equal(belief[name], value)


@pytest.mark.parametrize(("status", "x"), [("lost", 0.02), ("expected", 0.3)])
def test_a_body_that_is_lost_keeps_its_prediction_and_one_that_is_expected_the_arms(status: str, x: float) -> None:
    spatial = node(at(0.02))
    belief = spatial.observe((sighting(at(0.3), status=status), CAMERA), spatial.initial_belief(), Tick(time_s=0.0))
    (body,) = belief["bodies"]
    np.testing.assert_array_equal(body["pose"], at(x))
    assert body["status"] == status
    assert spatial.metrics(belief)["lost"] == (1.0 if status == "lost" else 0.0)


@pytest.mark.parametrize("interval_s", [1.0 / 30.0, 1.0])
def test_without_a_table_a_steady_motion_is_learnt_and_foretold(interval_s: float) -> None:
    step = np.array([0.004, -0.002, 0.001])
    turn, start = np.array([0.01, 0.02, -0.03]), exp_so3(np.array([0.7, -0.4, 1.1]))
    poses = [make_pose(exp_so3(k * turn) @ start, k * step) for k in range(40)]
    belief = follow(node(poses[0], damping=0.0), poses, interval_s)
    (body,) = belief["bodies"]
    np.testing.assert_allclose(body["velocity"] * interval_s, np.concatenate((step, turn)), atol=1e-6)
    distance, angle = pose_error(body["pose"], make_pose(exp_so3(40 * turn) @ start, 40 * step))
    assert distance < 1e-6
    assert angle < 1e-6


def test_without_a_table_nothing_falls() -> None:
    belief = follow(node(at(z=0.4)), [at(z=0.4)] * 5, 1 / 30)
    np.testing.assert_allclose(belief["bodies"][0]["pose"], at(z=0.4), atol=1e-12)


def test_damping_slows_a_body_that_is_seen_no_more() -> None:
    spatial = node(at(), damping=2.0)
    moving = follow(spatial, [at(0.003 * k) for k in range(30)], 0.1)
    before = float(moving["bodies"][0]["velocity"][0])
    after = spatial.predict((), (), moving)
    assert float(after["bodies"][0]["velocity"][0]) == pytest.approx(before * np.exp(-0.2))


@pytest.mark.parametrize("table", [False, True])
def test_a_plate_that_is_modelled_without_thickness_has_finite_covariances_seen_or_not(table: bool) -> None:
    flat = {"vertices": MESH.vertices * [1.0, 1.0, 0.0], "faces": MESH.faces}
    objects = [{"id": 1, "obj_id": 11, "pose": at(z=0.001), "model": flat}]
    spatial = SpatialNode(objects, table=table)
    assert spatial.initial_belief()["bodies"][0]["mass"] > 0.0
    for step_m in (0.0, 0.003):
        for status in ("tracked", "expected"):
            with np.errstate(all="raise"):
                belief = follow(spatial, [at(step_m * k, z=0.001) for k in range(4)], 0.1, status)
            assert np.isfinite(belief["bodies"][0]["covariance"]).all()


def test_over_a_table_things_settle_where_the_arm_is_not_sure() -> None:
    spatial = node(at(z=0.10), table=True)
    belief = spatial.initial_belief()
    for epoch in range(30):
        tick = Tick(epoch=epoch + 1, time_s=epoch / 30)
        pose = belief["bodies"][0]["pose"]
        belief = spatial.observe((sighting(pose, status="expected", covariance=VAGUE), CAMERA), belief, tick)
        belief = spatial.predict((), (), belief)
    assert belief["bodies"][0]["pose"][2, 3] == pytest.approx(SIDE_M / 2, abs=0.001)


@pytest.mark.parametrize("table", [True, False])
def test_over_a_table_what_loses_its_support_is_looked_for_everywhere_from_the_second_image_on(table: bool) -> None:
    spatial = node(at(), table=table)
    belief = follow(spatial, [at()] * 3, 1 / 30)
    sweeping = []
    for epoch, status in enumerate(["expected", "expected", "expected", "lost", "tracked"], start=4):
        tick = Tick(epoch=epoch, time_s=epoch / 30)
        belief = spatial.observe((sighting(at(), status=status, sought=status != "tracked"), CAMERA), belief, tick)
        belief = spatial.predict((), (), belief)
        sweeping.append(belief["sweeping"])
    assert sweeping == ([(), (1,), (1,), (1,), ()] if table else [None] * 5)


def test_what_the_arm_is_sure_of_physics_moves_no_farther_than_its_uncertainty() -> None:
    """A body held in the air, far above the table, is not let fall out of sight."""
    belief = follow(node(at(z=0.10), table=True, max_sigmas=3.0), [at(z=0.10)] * 20, 1 / 30)
    foretold = float(belief["bodies"][0]["pose"][2, 3])
    assert foretold == pytest.approx(0.10 - 3.0 * 0.0005, abs=1e-5)
    np.testing.assert_allclose(belief["bodies"][0]["velocity"], 0.0, atol=1e-9)


def test_a_body_that_is_found_again_is_not_thought_to_have_jumped() -> None:
    spatial = node(at())
    belief = spatial.initial_belief()
    for epoch, (x, status) in enumerate([(0.0, "tracked"), (0.0, "lost"), (0.2, "tracked")]):
        seen = (sighting(at(x), status=status), CAMERA)
        belief = spatial.predict((), (), spatial.observe(seen, belief, Tick(epoch=epoch + 1, time_s=0.1 * epoch)))
    np.testing.assert_allclose(belief["bodies"][0]["velocity"], 0.0)
    np.testing.assert_allclose(belief["bodies"][0]["pose"], at(0.2))


def test_interpenetration_is_resolved_within_the_uncertainty() -> None:
    spatial = node(at(0.0), at(0.055), table=True)
    belief = spatial.initial_belief()
    wide = np.diag([0.004**2] * 3 + [0.02**2] * 3)
    seen = (sighting(at(0.0), 1, covariance=wide), sighting(at(0.055), 2, covariance=wide), CAMERA)
    belief = spatial.predict((), (), spatial.observe(seen, belief, Tick(time_s=0.0)))
    first, second = belief["bodies"]
    assert second["pose"][0, 3] - first["pose"][0, 3] > 0.0555


def test_a_resting_stack_stays() -> None:
    poses = (at(0.0), at(0.01, z=1.5 * SIDE_M, yaw=0.5))
    spatial = node(*poses, table=True)
    belief = spatial.initial_belief()
    rng = np.random.default_rng(3)
    for epoch in range(30):
        noisy = [pose @ exp_se3(rng.normal(0, [0.0003] * 3 + [0.002] * 3)) for pose in poses]
        seen = (sighting(noisy[0], 1), sighting(noisy[1], 2), CAMERA)
        belief = spatial.predict((), (), spatial.observe(seen, belief, Tick(epoch=epoch + 1, time_s=epoch / 30)))
        for body, pose in zip(belief["bodies"], poses, strict=True):
            distance, angle = pose_error(body["pose"], pose)
            assert distance < 0.003
            assert angle < np.radians(2.0)


def test_nothing_observed_changes_nothing_but_the_time() -> None:
    spatial = node(at())
    belief = spatial.observe((), spatial.initial_belief(), Tick(time_s=0.0))
    assert belief["camera"] is None
    assert belief["bodies"] == spatial.initial_belief()["bodies"]


def test_arguments_are_not_changed_and_results_repeat_to_the_bit() -> None:
    spatial = node(at(), at(0.08), table=True)
    belief = decode_value(encode_value(spatial.initial_belief()))
    seen = (sighting(at(0.002, yaw=0.1)), CAMERA)
    before = encode_value((belief, seen))
    results = [encode_value(spatial.predict((), (), spatial.observe(seen, belief, Tick(time_s=0.5)))) for _ in range(2)]
    other = node(at(), at(0.08), table=True)
    results.append(encode_value(other.predict((), (), other.observe(seen, belief, Tick(time_s=0.5)))))
    assert results[0] == results[1] == results[2]
    assert encode_value((belief, seen)) == before


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"velocity_gain": 1.5}, "velocity_gain"),
        ({"damping": -1.0}, "damping"),
        ({"max_sigmas": -1.0}, "max_sigmas"),
        ({"friction": -0.1}, "friction"),
    ],
)
def test_options_out_of_range_are_named(options: dict[str, float], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        node(at(), **options)


def test_what_is_seen_where_it_cannot_rest_is_imagined_where_it_can() -> None:
    spatial, asked = node(at(z=0.10), table=True), []
    belief = spatial.initial_belief()
    for epoch in range(60):
        belief = spatial.observe((sighting(at(z=0.10)), CAMERA), belief, Tick(epoch=epoch + 1, time_s=epoch / 30))
        belief = spatial.predict((), (), belief)
        (body,) = belief["bodies"]
        assert (body["stands"], body["hangs"]) == (False, epoch + 1)
        if len(body["others"]):
            asked.append(body["hangs"])
            assert body["kept"] == 0
            np.testing.assert_allclose(body["others"][:, 2, 3], SIDE_M / 2, atol=1e-9)
            np.testing.assert_allclose(body["others"][:, :2, 3], 0.0, atol=1e-9)  # the camera looks straight down
    assert asked == [3, 6, 9, 12, 15, 24, 48]
    seen = (sighting(at()), CAMERA)
    body = spatial.predict((), (), spatial.observe(seen, belief, Tick(epoch=61, time_s=2.0)))["bodies"][0]
    body = spatial.predict((), (), spatial.observe(seen, {**belief, "bodies": (body,)}, Tick(epoch=62, time_s=2.1)))
    assert body["bodies"][0]["hangs"] == 0


@pytest.mark.parametrize(("status", "table"), [("expected", True), ("tracked", False)])
def test_what_is_not_seen_or_needs_no_table_does_not_hang(status: str, table: bool) -> None:
    spatial = node(at(z=0.10), table=table)
    belief = spatial.initial_belief()
    for epoch in range(5):
        seen = (sighting(at(z=0.10), status=status), CAMERA)
        belief = spatial.predict((), (), spatial.observe(seen, belief, Tick(epoch=epoch + 1, time_s=epoch / 30)))
    (body,) = belief["bodies"]
    assert (body["hangs"], len(body["others"])) == (0, 0)


@pytest.mark.parametrize("sought", [True, False])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_what_is_found_again_far_away_has_fallen_over_the_way_it_went(way: float, sought: bool) -> None:
    mesh = box_mesh([0.03, 0.04, 0.08])
    model = {"vertices": mesh.vertices, "faces": mesh.faces}
    pose = make_pose(np.eye(3), np.array([0.0, 0.0, 0.04]))
    spatial = SpatialNode([{"id": 1, "obj_id": 1, "pose": pose, "model": model}], table=True)
    belief = spatial.observe((sighting(pose), CAMERA), spatial.initial_belief(), Tick(1, 0.0))
    belief = spatial.predict((), (), belief)
    # It lies on one of its sides, turned by half: outlines do not tell that.
    fallen = make_pose(exp_so3(np.array([0.0, way * np.pi / 2, 0.0])), np.array([way * 0.15, 0.0, 0.015]))
    turned = fallen @ make_pose(exp_so3(np.array([0.0, np.pi, 0.0])), np.zeros(3))
    for guess in (fallen, turned):
        lost = {**sighting(pose, status="lost"), "guesses": guess[None], "sought": sought}
        after = spatial.predict((), (), spatial.observe((lost, CAMERA), belief, Tick(2, 1 / 30)))
        np.testing.assert_allclose(after["bodies"][0]["others"][0], fallen, atol=1e-6)
