"""What the arm shows of why it believes what it does: nats by source, by edge and of other poses."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from support.coloured import BLUE, CAMERA, GREEN, INTRINSICS, POSES, RED, item, taught
from support.coloured import imagined as imagined_cube
from support.coloured import picture as cubes_in
from support.cube_arm import FIRST_CAMERA, WORLD_FROM_OBJECT, after_first_epoch, imagined, node, picture

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.evidence import Evidence, evidence, sought
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose
from hierax.runtime import Step
from hierax.runtime.core.showing import Curve, Lines2D

MOTION = np.diag([0.01**2] * 3 + [0.06**2] * 3)
TURNED = make_pose(exp_so3(np.array([0.0, 0.0, 0.09])), [0.004, 0.0, 0.0])


@cache
def seen() -> tuple[Any, Step, Any]:
    """An arm, its second epoch, in which an object is compared with another pose, and the belief before."""
    arm = node()
    before = after_first_epoch(arm)
    shown = picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 2)
    sensed = arm.observe((shown,), before)
    (context,) = imagined(FIRST_CAMERA, WORLD_FROM_OBJECT, sensed["objects"][0]["covariance"])
    (pose,) = context["poses"]
    other = {"pose": pose["pose"] @ TURNED, "controls": pose["controls"], "kept": True}
    context = {**context, "poses": ({**pose, "others": (other,)},)}
    after = arm.predict((context,), (), sensed)
    return arm, Step(2, 1, 0.1, (shown,), sensed, (), (context,), "default", (), after), before


def of(step: Step, before: Any) -> Evidence:
    (found,) = evidence(step.observations[0]["image"], step.sensed, before, step.belief, MOTION)
    return found


def test_parts_and_edges_make_up_what_the_arm_said() -> None:
    _, step, before = seen()
    (item,) = step.sensed["objects"]
    found = of(step, before)
    assert item["status"] == "tracked"
    assert found.nats == pytest.approx(item["nats"], abs=0.05 * item["nats"])
    assert found.nats == pytest.approx(found.found + found.missing + found.looks + found.wholes + found.colours)
    assert found.nats == pytest.approx(sum(edge.nats for edge in found.edges) + found.colours)
    assert found.prior is not None
    assert -6.0 < found.prior <= 0.0
    assert {edge.number for edge in found.edges} == set(item["controls"]["edges"].tolist())
    assert all(edge.seen > 0.8 * edge.expected and abs(edge.off_px) < 0.5 for edge in found.edges)
    assert all(edge.off_mm / edge.off_px == pytest.approx(1000.0 * 0.5 / 500.0, rel=1.0) for edge in found.edges)


def test_without_the_belief_before_there_is_no_prediction() -> None:
    _, step, _ = seen()
    found = of(step, None)
    assert found.prior is None
    assert [other.name for other in found.others] == ["compared before"]


def test_edges_that_are_not_seen_speak_against_a_pose() -> None:
    _, step, before = seen()
    (item,) = step.sensed["objects"]
    wrong = {**step.sensed, "objects": ({**item, "pose": item["pose"] @ make_pose(np.eye(3), [0.03, 0.0, 0.0])},)}
    found = of(step._replace(sensed=wrong), before)
    assert found.nats < 0.0
    last = found.edges[-1]
    assert (last.seen, last.nats < -1.0) == (0.0, True)
    assert np.isnan(last.off_px)


def test_other_poses_are_told_with_what_they_are_worth() -> None:
    _, step, before = seen()
    found = of(step, before)
    assert {other.name for other in found.others} == {"as predicted", "compared before"}
    assert [other.nats for other in found.others] == sorted((other.nats for other in found.others), reverse=True)
    predicted = next(other for other in found.others if other.name == "as predicted")
    assert predicted.away_mm < 10.0


def test_colours_are_a_part_of_what_is_said_where_they_are_its_own_and_where_another_is_seen() -> None:
    looks = taught(RED, GREEN, BLUE)
    objects = tuple(item(number, POSES[number], looks[which]) for number, which in enumerate((0, 1, 0)))
    belief: Any = {"intrinsics": INTRINSICS, "camera": CAMERA, "objects": objects}
    own, _, mistaken = evidence(cubes_in(RED, GREEN, BLUE), belief, None, belief, MOTION)
    assert own.colours > const.CLEAR_NATS
    assert mistaken.colours < -const.CLEAR_NATS
    for found in (own, mistaken):
        assert found.nats == pytest.approx(found.found + found.missing + found.looks + found.wholes + found.colours)
    grey = cv2.cvtColor(cubes_in(RED, GREEN, BLUE), cv2.COLOR_RGB2GRAY)
    assert [found.colours for found in evidence(grey, belief, None, belief, MOTION)] == [0.0, 0.0, 0.0]


def test_it_is_shown_in_words_as_curves_and_over_the_picture() -> None:
    arm, step, before = seen()
    things = arm.show(step, before)
    (item,) = step.sensed["objects"]
    curves = {name: things[f"/{name}/3"] for name in ("scores", "probability", "nats")}
    assert all(isinstance(curve, Curve) for curve in curves.values())
    assert curves["probability"].value == item["probability"] > 0.9
    assert curves["nats"].value == item["nats"]
    drawn = things["/evidence/for"]
    assert isinstance(drawn, Lines2D)
    assert len(drawn.lines) > 20
    assert isinstance(things["/evidence/instead/3/0"], Lines2D)
    text = things["why"]
    assert text.startswith("### object 3: tracked\n\nP 1.00 that it is right by 5 mm and 5°, 1.00 that it is there")
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert lines[0].split("|")[1].strip() == "edge"
    assert len(lines) == 2 + len(of(step, before).edges) + 2 + 2


def test_of_what_is_lost_it_is_told_where_it_may_be() -> None:
    """Its place among three cubes, and that of another one, as the spatial node asks for them."""
    looks = taught(RED, GREEN, BLUE)
    places = tuple(imagined_cube(POSES[at]) for at in (0, 1))
    lost = {**item(0, POSES[2], looks[0], status="lost", failed_searches=7, lead=5.0), "others": places}
    belief: Any = {"intrinsics": INTRINSICS, "camera": CAMERA, "objects": (lost, item(2, POSES[2], looks[2]))}
    (found,) = sought(cubes_in(RED, GREEN, BLUE), belief, belief)
    assert [np.allclose(other.pose, POSES[at]) for at, other in enumerate(found.others)] == [True, True]
    assert found.others[0].nats > 15.0
    assert found.others[0].nats > found.others[1].nats + const.CLEAR_NATS, "the other one has other colours"
    text = found.text()
    assert "looked for everywhere 7 times, and may be in 2 places. It leads by 5.0 nats" in text
    assert f"{1000.0 * POSES[0][2, 3]:.0f} | " in text
    nowhere: Any = {**belief, "objects": ({**lost, "others": (), "lead": 0.0},)}
    (found,) = sought(cubes_in(RED, GREEN, BLUE), nowhere, nowhere)
    assert "may be in 0 places. None leads" in found.text()


def test_what_is_not_expected_to_be_seen_is_not_told_of() -> None:
    arm = node()
    shown = picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1)
    belief = arm.observe((shown,), arm.initial_belief())
    things = arm.show(Step(1, 1, 0.0, (shown,), belief, (), (), "default", (), belief), None)
    assert "why" not in things
    assert not [path for path in things if path.startswith("/evidence")]
