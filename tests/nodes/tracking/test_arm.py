"""The arm node: corrected by images, shaped by context, honest about what it has lost."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE
from support.cube_arm import FIRST_CAMERA, NEXT_CAMERA, WORLD_FROM_OBJECT, after_first_epoch, imagined, node, picture

from hierax.nodes.tracking import arm as tracking_arm
from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.estimation.tracked import NO_CONTROLS
from hierax.nodes.tracking.math.geometry import NO_POSES, exp_so3, make_pose, pose_error
from hierax.nodes.tracking.search.association import Estimate
from hierax.nodes.tracking.search.missing import Sighting
from hierax.runtime import Tick
from hierax.schemas.values import decode_value, encode_value


def test_the_first_frame_is_as_given() -> None:
    arm = node()
    assert poses_seen(arm.initial_belief()) == ()
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1, 12),), arm.initial_belief())
    seen, camera = poses_seen(belief)
    assert seen["status"] == "expected"
    assert np.array_equal(seen["pose"], WORLD_FROM_OBJECT)
    assert (camera["frame"], camera["size"]) == (12, SIZE)


def test_a_prediction_is_corrected_while_the_camera_moves() -> None:
    arm = node()
    wrong = WORLD_FROM_OBJECT @ make_pose(exp_so3(np.array([0.02, -0.02, 0.03])), [0.004, -0.003, 0.004])
    belief = after_first_epoch(arm, wrong)
    assert len(belief["objects"][0]["edges"]) >= 6
    belief = arm.observe((picture(NEXT_CAMERA, WORLD_FROM_OBJECT, 2),), belief)
    seen, camera = poses_seen(belief)
    assert seen["status"] == "tracked"
    assert seen["score"] > 0.9
    distance, angle = pose_error(seen["pose"], WORLD_FROM_OBJECT)
    assert distance < 0.001
    assert angle < np.radians(0.4)
    assert pose_error(camera["camera"], NEXT_CAMERA)[0] < 0.001
    assert np.linalg.eigvalsh(seen["covariance"]).min() > 0


def test_without_context_everything_is_lost() -> None:
    arm = node()
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), arm.initial_belief())
    belief = arm.predict((), (), belief)
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 2),), belief)
    assert [(item["status"], item["score"]) for item in belief["objects"]] == [("lost", 0.0)]
    assert [(item["nats"], item["probability"]) for item in belief["objects"]] == [(0.0, 0.0)]
    assert arm.metrics(belief) == {"tracked": 0.0, "lost": 1.0, "score_mean": 0.0}


def test_before_its_first_context_may_come_nothing_is_lost() -> None:
    arm = node(waits=2)
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), arm.initial_belief())
    for epoch in (1, 2):
        belief = arm.observe(
            (picture(FIRST_CAMERA, WORLD_FROM_OBJECT, epoch),), arm.predict((), (), belief, Tick(epoch=epoch))
        )
        assert [item["status"] for item in belief["objects"]] == ["expected"]
    assert [item["status"] for item in arm.predict((), (), belief, Tick(epoch=3))["objects"]] == ["lost"]


def test_what_context_no_longer_tells_of_is_no_longer_probable() -> None:
    arm = node()
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), after_first_epoch(arm))
    assert belief["objects"][0]["probability"] > 0.9
    (item,) = arm.predict((), (), belief)["objects"]
    assert (item["status"], item["score"], item["nats"], item["probability"]) == ("lost", 0.0, 0.0, 0.0)


def test_where_nothing_is_expected_the_image_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking_arm, "smoothed", lambda image: pytest.fail("the image was smoothed"))
    arm = node()
    arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), arm.initial_belief())


@pytest.mark.parametrize(("status", "after"), [("tracked", "expected"), ("expected", "expected"), ("lost", "lost")])
def test_where_nothing_is_in_view_nothing_is_tracked_and_no_guess_is_kept(status: str, after: str) -> None:
    arm = node()
    belief = after_first_epoch(arm)
    (item,) = belief["objects"]
    unseen = {**item, "status": status, "controls": NO_CONTROLS, "guesses": WORLD_FROM_OBJECT[None]}
    seen = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), {**belief, "objects": (unseen,)})
    assert (seen["objects"][0]["status"], len(seen["objects"][0]["guesses"])) == (after, 0)


@pytest.mark.parametrize(
    ("tolerance", "nats", "status"),
    [(0.0007, 3.0, "tracked"), (0.0007, -1.0, "expected"), (0.0, 3.0, "expected"), (None, 3.0, "expected")],
)
def test_of_an_imprecise_model_not_the_share_that_is_found_says_whether_it_is_there(
    tolerance: float | None, nats: float, status: str
) -> None:
    arm = node()
    (item,) = after_first_epoch(arm)["objects"]
    slots = {**item["slots"], "tolerance": tolerance}
    pose, covariance = WORLD_FROM_OBJECT, np.diag([1e-6] * 3 + [1e-4] * 3)
    estimate = Estimate(
        *(pose, covariance, 0.1, np.zeros(6)), 0.3, 60.0, nats, 0.0, 0.5, slots, *(0, False, True), NO_POSES
    )
    assert arm._judged(item, pose, estimate)["status"] == status


@pytest.mark.parametrize("found", [True, False])
def test_what_is_looked_for_everywhere_is_as_probable_as_it_explains_the_image(found: bool) -> None:
    (item,) = node().initial_belief()["objects"]
    stale = {**item, "nats": 30.0, "probability": 0.99, "status": "lost", "lead": 13.0}
    pose, covariance = (WORLD_FROM_OBJECT, np.diag([1e-6] * 3 + [1e-4] * 3)) if found else (None, None)
    said = (0.9, 20.0, 9.0, True) if found else (0.0, 0.0, 0.0, False)
    seen = tracking_arm._sighted(stale, Sighting(NO_POSES, pose, covariance, *said), False)
    assert seen["nats"] == (20.0 if found else 0.0)
    assert (seen["probability"] > 0.9) == found


@pytest.mark.parametrize(
    ("lead", "again", "images"), [(6.1, True, 3), (40.0, True, 3), (4.0, True, 5), (2.1, True, 9), (40.0, False, None)]
)
def test_a_missing_object_is_tracked_when_images_in_a_row_have_it_in_one_place_the_more_the_less_clear_they_are(
    lead: float, again: bool, images: int | None
) -> None:
    (item,) = node().initial_belief()["objects"]
    item = {**item, "status": "lost"}
    sighting = Sighting(NO_POSES, WORLD_FROM_OBJECT, np.diag([1e-6] * 3 + [1e-4] * 3), 0.9, 20.0, lead, again)
    statuses = []
    for _ in range(9 if images is None else images):
        item = tracking_arm._sighted(item, sighting, False)
        statuses.append(item["status"])
        assert item["probability"] == 0.0 or item["status"] == "tracked"
        assert item["status"] == "tracked" or np.array_equal(item["guesses"], WORLD_FROM_OBJECT[None])
    assert statuses == (["lost"] * 9 if images is None else ["lost"] * (images - 1) + ["tracked"])
    missing = tracking_arm._sighted({**item, "status": "lost"}, Sighting(NO_POSES), False)
    assert (missing["probation"], missing["lead"]) == (0, 0.0)


def test_what_is_expected_is_missing_as_soon_as_one_image_has_it_elsewhere() -> None:
    (item,) = node().initial_belief()["objects"]
    item = {**item, "status": "expected", "misses": 5, "guesses": FIRST_CAMERA[None]}
    suspected = tracking_arm._sighted(item, Sighting(WORLD_FROM_OBJECT[None]), True)
    assert suspected["status"] == "expected"
    np.testing.assert_array_equal(suspected["guesses"], [WORLD_FROM_OBJECT, FIRST_CAMERA])
    covariance = np.diag([1e-6] * 3 + [1e-4] * 3)
    unclear = Sighting(NO_POSES, WORLD_FROM_OBJECT, covariance, 0.9, 20.0, const.CLEAR_NATS - 0.1)
    guessed = tracking_arm._sighted(item, unclear, True)
    assert (guessed["status"], guessed["lead"]) == ("expected", 0.0)
    np.testing.assert_array_equal(guessed["guesses"], [WORLD_FROM_OBJECT, FIRST_CAMERA])
    found = Sighting(NO_POSES, WORLD_FROM_OBJECT, covariance, 0.9, 20.0, 9.0, True)
    statuses = []
    for _ in range(3):
        item = tracking_arm._sighted(item, found, False)
        statuses.append(item["status"])
    assert statuses == ["lost", "lost", "tracked"]


def test_a_lead_ends_where_what_is_missing_is_expected_or_not_seen() -> None:
    (item,) = after_first_epoch(node())["objects"]
    leading = {**item, "lead": 12.0}
    assert node()._missed(leading, item["pose"], None)["lead"] == 0.0
    assert tracking_arm.unseen(leading)["lead"] == 0.0


def test_what_is_seen_again_is_not_looked_for_everywhere_though_a_sweep_of_it_came_down() -> None:
    arm = node()
    belief = after_first_epoch(arm)
    (known,) = belief["objects"]
    sweep = {"id": known["id"], "places": WORLD_FROM_OBJECT[None], "templates": (), "rough_m": 0.001}
    image = tracking_arm.smoothed(picture(NEXT_CAMERA, WORLD_FROM_OBJECT, 2)["image"])
    nowhere = {name: each[:0] for name, each in known["controls"].items()}
    gone = {**known, "id": 99, "status": "lost", "controls": nowhere}
    other = {"pose": WORLD_FROM_OBJECT, "controls": known["controls"], "kept": True}
    seen, level = {**known, "status": "tracked"}, np.array([0.0, 0.0, 1.0, 0.5])
    guessed = {known["id"]: (), 99: (other,)}
    after = arm._searched(image, (seen, gone), guessed, (sweep,), INTRINSICS, level)
    assert [item["id"] for item in after] == [known["id"], 99]
    assert after[0] is seen


@pytest.mark.parametrize("probation", [20, 0])
def test_what_was_found_just_now_goes_back_when_images_are_explained_better_without_it(probation: int) -> None:
    arm = node()
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), after_first_epoch(arm))
    (item,) = belief["objects"]
    belief = {**belief, "objects": ({**item, "probation": probation},)}
    statuses = []
    for epoch in range(3):
        covariance = belief["objects"][0]["covariance"]
        belief = arm.predict(imagined(FIRST_CAMERA, WORLD_FROM_OBJECT, covariance), (), belief)
        belief = arm.observe((picture(FIRST_CAMERA, None, epoch),), {**belief, "sweeps": ()})
        statuses.append(belief["objects"][0]["status"])
    assert statuses == ["expected", "expected", "lost" if probation else "expected"]


def test_what_vanishes_is_lost_and_what_returns_is_found() -> None:
    arm = node(patience=3)
    belief = after_first_epoch(arm)
    statuses = []
    for epoch, there in enumerate([True, False, False, False, False, True, True]):
        shown = WORLD_FROM_OBJECT if there else None
        belief = arm.observe((picture(FIRST_CAMERA, shown, epoch),), belief)
        statuses.append(belief["objects"][0]["status"])
        covariance = belief["objects"][0]["covariance"]
        belief = arm.predict(imagined(FIRST_CAMERA, WORLD_FROM_OBJECT, covariance), (), belief)
    assert statuses == ["tracked", "expected", "expected", "lost", "lost", "tracked", "tracked"]


def test_a_pose_that_nothing_shows_becomes_less_certain() -> None:
    arm = node()
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), after_first_epoch(arm))
    before = belief["objects"][0]["covariance"]
    belief = arm.predict(imagined(FIRST_CAMERA, WORLD_FROM_OBJECT, before), (), belief)
    belief = arm.observe((picture(FIRST_CAMERA, None, 1),), belief)
    assert np.linalg.eigvalsh(belief["objects"][0]["covariance"] - before).min() > 0


def test_operators_are_pure_and_beliefs_are_values() -> None:
    arm = node()
    belief = after_first_epoch(arm)
    kept = encode_value(belief)
    seen = picture(NEXT_CAMERA, WORLD_FROM_OBJECT, 2)
    first = encode_value(arm.observe((seen,), belief))
    again = encode_value(node().observe((seen,), decode_value(kept)))
    assert first == again
    assert encode_value(belief) == kept
    assert len(kept) < 100_000


def test_without_an_observation_what_was_tracked_is_expected() -> None:
    arm = node()
    belief = after_first_epoch(arm)
    blind = arm.observe((), belief)
    assert blind["frame"] is None
    assert poses_seen(blind) == ()
    for item, before in zip(blind["objects"], belief["objects"], strict=True):
        assert item["status"] == ("lost" if before["status"] == "lost" else "expected")
        np.testing.assert_array_equal(item["pose"], before["pose"])
    first = arm.initial_belief()
    assert arm.observe((), first)["objects"] == first["objects"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"motion_m": 0.0}, "motion_m is 0.0; expected a positive"),
        ({"kept_score": 0.8}, "kept_score is 0.8; expected 0 to 0.7, at which a lost one is found"),
        ({"patience": 0}, "patience is 0"),
    ],
)
def test_bad_options(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        node(**options)


def test_bad_objects() -> None:
    pose = np.eye(4)
    with pytest.raises(ValueError, match="from 1 to 255"):
        ArmNode([{"id": 1, "obj_id": 1, "pose": pose}, {"id": 1, "obj_id": 1, "pose": pose}])
    with pytest.raises(ValueError, match="object 4: pose"):
        ArmNode([{"id": 4, "obj_id": 1, "pose": np.eye(3)}])


@pytest.mark.parametrize(("nats", "denied"), [(-0.5, 1), (0.5, 0)])
def test_an_image_that_clutter_explains_no_better_says_nothing_against_what_it_does_not_support(
    nats: float, denied: int
) -> None:
    arm = node()
    (item,) = after_first_epoch(arm)["objects"]
    pose, covariance = WORLD_FROM_OBJECT, np.diag([1e-6] * 3 + [1e-4] * 3)
    said = (0.1, 60.0, nats, 0.0, 0.5)
    estimate = Estimate(pose, covariance, 0.1, np.zeros(6), *said, item["slots"], 0, False, True, NO_POSES)
    judged = arm._judged(item, pose, estimate)
    assert (judged["status"], judged["misses"], judged["denied"]) == ("expected", 1, denied)


@pytest.mark.parametrize(("known", "status"), [(True, "tracked"), (False, "lost")])
def test_what_is_known_by_its_colours_is_found_in_one_image(known: bool, status: str) -> None:
    (item,) = after_first_epoch(node())["objects"]
    lost = {**item, "status": "lost"}
    sighting = Sighting(NO_POSES, WORLD_FROM_OBJECT, np.diag([1e-6] * 3 + [1e-4] * 3), 0.9, 20.0, 9.0, False, known)
    found = tracking_arm._sighted(lost, sighting, True)  # type: ignore[arg-type]
    assert found["status"] == status
    assert (found["probation"], found["lead"]) == ((const.PROBATION, 0.0) if known else (0, const.CLEAR_NATS))


def test_what_has_the_colours_of_something_else_is_not_seen() -> None:
    arm = node()
    (item,) = after_first_epoch(arm)["objects"]
    pose, covariance = WORLD_FROM_OBJECT, np.diag([1e-6] * 3 + [1e-4] * 3)
    for colours, status, denied in ((0.0, "tracked", 0), (-9.0, "expected", 1)):
        said = (0.9, 60.0, 20.0 + colours, colours, 0.5)
        estimate = Estimate(pose, covariance, 0.1, np.zeros(6), *said, item["slots"], 0, False, True, NO_POSES)
        judged = arm._judged(item, pose, estimate)
        assert (judged["status"], judged["denied"]) == (status, denied)


@pytest.mark.parametrize(
    ("hangs", "probation", "missing", "after"),
    [(9, 5, False, "tracked"), (10, 5, False, "lost"), (10, 0, False, "tracked"), (10, 5, True, "tracked")],
)
def test_what_was_found_just_now_and_hangs_there_is_not_there_unless_a_missing_one_may_carry_it(
    hangs: int, probation: int, missing: bool, after: str
) -> None:
    arm = node()
    belief = after_first_epoch(arm)
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), belief)
    (item,) = belief["objects"]
    doubted = {**item, "hangs": hangs, "probation": probation}
    other = {**item, "id": item["id"] + 1, "status": "lost", "controls": NO_CONTROLS}
    objects = (doubted, other) if missing else (doubted,)
    guessed = {other["id"]: ()}
    seen = arm._searched(None, objects, guessed, (), INTRINSICS, np.zeros(4))  # type: ignore[arg-type]
    assert seen[0]["status"] == after
