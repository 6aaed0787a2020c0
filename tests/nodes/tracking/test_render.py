"""TinyRenderer against exact ray casting, and as a pure function."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, cast

from hierax.nodes.tracking.constants import COVERED_AFTER
from hierax.nodes.tracking.math.geometry import NO_POSES, exp_so3, invert, looking_down, make_pose
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.render import DepthRenderer, Item, SegmentedDepth


def some_boxes(rng: np.random.Generator, count: int) -> list[Box]:
    poses = [
        make_pose(
            exp_so3(rng.normal(size=3)), [rng.uniform(-0.25, 0.25), rng.uniform(-0.2, 0.2), rng.uniform(0.3, 0.8)]
        )
        for _ in range(count)
    ]
    return [Box(7 * at + 1, tuple(rng.uniform(0.03, 0.1, 3)), pose) for at, pose in enumerate(poses)]


def items(boxes: list[Box]) -> list[Item]:
    return [Item(box.label, *box_mesh(box.size), box.pose) for box in boxes]


@pytest.mark.parametrize("seed", range(6))
def test_equal_to_ray_casting(seed: int) -> None:
    boxes = some_boxes(np.random.default_rng(seed), 3)
    renderer = DepthRenderer()
    depth, labels = renderer.render(items(boxes), INTRINSICS, SIZE)
    exact = cast(boxes)
    # A pixel centre within rounding of an edge may fall to either side.
    assert (labels != exact.labels).sum() <= 3
    both = (labels == exact.labels) & (labels > 0)
    assert both.any()
    # Where two boxes cut through each other, or a face is seen edge-on, the depth of one pixel may differ.
    assert np.quantile(np.abs(depth[both] - exact.depth[both]), 0.999) < 5e-6
    assert (depth[labels == 0] == 0).all()


def test_an_image_depends_on_its_arguments_alone() -> None:
    boxes = some_boxes(np.random.default_rng(9), 4)
    others = some_boxes(np.random.default_rng(10), 4)
    used, fresh = DepthRenderer(), DepthRenderer()
    moved = [box._replace(pose=other.pose) for box, other in zip(boxes, others, strict=True)]
    for earlier in (items(moved), items(others[:2]), items(moved)):
        used.render(earlier, INTRINSICS, SIZE)
    first = used.render(items(boxes)[::-1], INTRINSICS, SIZE)
    second = fresh.render(items(boxes), INTRINSICS, SIZE)
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])


def test_what_is_behind_or_beside_the_camera_is_not_drawn() -> None:
    renderer = DepthRenderer()
    mesh = box_mesh((0.05, 0.05, 0.05))
    for translation in ([0.0, 0.0, -0.5], [5.0, 0.0, 0.5]):
        depth, labels = renderer.render([Item(1, *mesh, make_pose(np.eye(3), translation))], INTRINSICS, SIZE)
        assert not labels.any()
        assert not depth.any()


def test_a_large_mesh_is_drawn_whole() -> None:
    # A sphere of 45 000 triangles, more than one shape of pybullet takes.
    rows, columns = 150, 150
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None]
    grid = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi]
    vertices = 0.05 * np.stack(grid, axis=-1).reshape(-1, 3)
    faces = []
    for row in range(rows):
        for column in range(columns):
            a, b = row * columns + column, row * columns + (column + 1) % columns
            faces += [(a, a + columns, b), (b, a + columns, b + columns)]
    renderer = DepthRenderer()
    pose = make_pose(np.eye(3), [0.0, 0.0, 0.5])
    depth, labels = renderer.render([Item(3, vertices, np.array(faces), pose)], INTRINSICS, SIZE)
    expected = np.pi * 525.0 * 530.0 * 0.05**2 / (0.5**2 - 0.05**2)
    assert (labels == 3).sum() == pytest.approx(expected, rel=0.01)
    assert depth[224, 313] == pytest.approx(0.45, abs=1e-4)


def test_labels_must_be_different_and_fit() -> None:
    mesh = box_mesh((0.1, 0.1, 0.1))
    pose = make_pose(np.eye(3), [0.0, 0.0, 0.5])
    for labels in ((1, 1), (0, 1), (1, 256)):
        with pytest.raises(ValueError, match="from 1 to 255"):
            DepthRenderer().render([Item(label, *mesh, pose) for label in labels], INTRINSICS, SIZE)


def test_context_is_the_scene_as_the_camera_sees_it() -> None:
    mesh = box_mesh((0.05, 0.05, 0.05))
    camera = make_pose(exp_so3(np.array([0.3, -0.2, 0.1])), [0.1, 0.2, -0.4])
    pose = make_pose(np.eye(3), [0.05, 0.1, 0.2])
    body = {"id": 5, "obj_id": 2, "pose": pose, "velocity": np.zeros(6), "covariance": np.eye(6), "status": "tracked"}
    body.update(support=np.zeros(3), stands=False, hangs=0, others=np.zeros((0, 4, 4)), kept=0)
    body["model"] = {"vertices": mesh.vertices, "faces": mesh.faces}
    belief = {"camera": camera, "intrinsics": INTRINSICS, "size": SIZE, "frame": 3, "bodies": (body,), "sweeping": None}
    context = SegmentedDepth()
    assert context({**belief, "camera": None}) == ()
    (element,) = context(belief)
    exact = cast([Box(5, (0.05, 0.05, 0.05), invert(camera) @ pose)])
    assert element["labels"].dtype == np.uint8
    assert element["depth"].dtype == np.float32
    left, top = element["corner"]
    height, width = element["labels"].shape
    view = np.s_[top : top + height, left : left + width]
    assert (element["labels"] != exact.labels[view]).sum() <= 2
    assert (exact.labels > 0).sum() == (exact.labels[view] > 0).sum() > 0
    assert element["size"] == SIZE
    assert element["intrinsics"].tolist() == (INTRINSICS - (0.0, 0.0, left, top)).tolist()
    assert np.array_equal(element["camera"], camera)
    assert element["poses"][0]["id"] == 5
    assert np.array_equal(element["poses"][0]["pose"], pose)


def lost_cube(number: int, side_m: float, turn: int) -> Any:
    mesh = box_mesh((side_m, side_m, side_m))
    body = {"id": number, "obj_id": number, "pose": np.eye(4), "velocity": np.zeros(6), "covariance": np.eye(6)}
    body.update(status="lost", support=np.zeros(3), stands=False, hangs=0, guesses=NO_POSES, others=NO_POSES, kept=0)
    return {**body, "turn": turn, "model": {"vertices": mesh.vertices, "faces": mesh.faces}}


@pytest.mark.parametrize(("turn", "heights"), [(11, [0.0, 0.06]), (COVERED_AFTER + 1, [0.0, 0.06, 0.09])])
def test_after_long_a_missing_body_is_looked_for_on_another_one_that_is_missing_too(
    turn: int, heights: list[float]
) -> None:
    below, between, sought = lost_cube(1, 0.06, 0), lost_cube(2, 0.03, 0), lost_cube(3, 0.04, turn)
    standing = {"pose": make_pose(np.eye(3), [0.0, 0.0, 0.03]), "status": "tracked", "stands": True}
    bodies = ({**below, **standing}, between, sought)
    seen = {"camera": looking_down(0.4, 0.75, 0.45, np.zeros(3)), "intrinsics": INTRINSICS, "size": SIZE, "frame": 3}
    (element,) = SegmentedDepth()({**seen, "bodies": bodies, "sweeping": (3,)})
    everywhere, carried = element["sweeps"]
    assert (everywhere["id"], carried["id"]) == (3, 3)
    assert np.unique(everywhere["places"][:, 2, 3]).tolist() == [0.0]
    assert np.unique(carried["places"][:, 2, 3].round(6)).tolist() == heights[1:]
    assert np.abs(carried["places"][:, :2, 3]).max() <= 0.03 + 1e-9


@pytest.mark.parametrize(("foot_m", "heights"), [(0.05, [0.01]), (0.04, [0.0]), (0.02, [])])
def test_a_missing_body_is_looked_for_below_one_that_nothing_known_carries(foot_m: float, heights: list[float]) -> None:
    hanging, sought = lost_cube(1, 0.06, 0), lost_cube(2, 0.04, 11)
    seen_there = {"pose": make_pose(np.eye(3), [0.0, 0.0, foot_m + 0.03]), "status": "tracked", "hangs": 2}
    bodies = ({**hanging, **seen_there}, sought)
    seen = {"camera": looking_down(0.4, 0.75, 0.45, np.zeros(3)), "intrinsics": INTRINSICS, "size": SIZE, "frame": 3}
    (element,) = SegmentedDepth()({**seen, "bodies": bodies, "sweeping": (2,)})
    places = [sweep["places"] for sweep in element["sweeps"][1:]]
    assert [each[0, 2, 3].round(6) for each in places] == heights
    assert all(np.abs(each[:, :2, 3]).max() <= 0.03 + 1e-9 for each in places)


def test_a_missing_body_is_also_looked_for_where_others_that_nobody_knows_would_carry_it() -> None:
    camera = looking_down(0.4, 0.75, 0.45, np.zeros(3))
    bodies = [lost_cube(number, side, number) for number, side in ((1, 0.05), (2, 0.03))]
    seen = {"camera": camera, "intrinsics": INTRINSICS, "size": SIZE, "frame": 3}
    (element,) = SegmentedDepth()({**seen, "bodies": tuple(bodies), "sweeping": (1, 2)})
    table, above = element["sweeps"]
    assert np.unique(table["places"][:, 2, 3]).tolist() == [0.0]
    assert table["rough_m"] == 0.0
    heights = np.unique(above["places"][:, 2, 3])
    assert len(heights) == 1
    assert 0.03 < heights[0] < 0.06
    assert above["rough_m"] > 0.005
