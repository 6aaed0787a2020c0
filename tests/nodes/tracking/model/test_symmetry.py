"""Symmetry: found from meshes, and of equal poses the one that is nearest."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from hierax.nodes.tracking.math.geometry import Floats, exp_se3, invert, pose_error
from hierax.nodes.tracking.model.mesh import Mesh, box_mesh
from hierax.nodes.tracking.model.symmetry import (
    about,
    alike,
    found_symmetry,
    is_plain,
    kept_free,
    moved_along,
    open_to,
    symmetry_of,
)

BOTTLE = [[0, 0], [0.03, 0], [0.03, 0.1], [0.012, 0.13], [0.012, 0.16], [0, 0.16]]
POSE = exp_se3(np.array([0.02, -0.03, 0.6, 0.4, -0.7, 0.9]))


def mesh(made: trimesh.Trimesh, scale: float = 1.0, pose: Floats | None = None) -> Mesh:
    moved = made.copy() if pose is None else made.copy().apply_transform(pose)
    return Mesh(scale * np.asarray(moved.vertices), np.asarray(moved.faces, dtype=np.int32))


@pytest.mark.parametrize(
    ("shape", "turns", "free"),
    [
        (box_mesh((0.05, 0.06, 0.08)), 4, 0),
        (box_mesh((0.05, 0.05, 0.08)), 8, 0),
        (box_mesh((0.05, 0.05, 0.05)), 24, 0),
        (box_mesh((0.05, 0.052, 0.05)), 8, 0),
        (mesh(trimesh.creation.cylinder(0.03, 0.1, sections=6)), 12, 0),
        (mesh(trimesh.creation.cylinder(0.03, 0.1, sections=64)), 2, 1),
        (mesh(trimesh.creation.revolve(BOTTLE, sections=64)), 1, 1),
        (mesh(trimesh.creation.revolve(BOTTLE, sections=64), pose=POSE), 1, 1),
        (mesh(trimesh.creation.torus(0.04, 0.012, major_sections=64)), 2, 1),
        (mesh(trimesh.creation.icosphere(3, radius=0.035), pose=POSE), 1, 3),
    ],
)
def test_symmetries_are_found_from_a_mesh(shape: Mesh, turns: int, free: int) -> None:
    found = found_symmetry(shape)
    assert (len(found["turns"]), len(found["free"])) == (turns, free)
    for turn in found["turns"]:
        moved = shape.vertices @ turn[:3, :3].T + turn[:3, 3]
        if not free:  # corners lie on corners
            apart = np.linalg.norm(moved[:, None] - shape.vertices[None], axis=2).min(axis=1)
            assert apart.max() < 0.0021


def test_a_tolerance_says_what_is_the_same() -> None:
    nearly = box_mesh((0.05, 0.0508, 0.08))
    assert len(found_symmetry(nearly)["turns"]) == 8
    assert len(found_symmetry(nearly, 0.0002)["turns"]) == 4


def test_what_has_a_handle_has_no_symmetry() -> None:
    handle = trimesh.creation.box((0.03, 0.01, 0.04))
    handle.apply_translation((0.04, 0.0, 0.01))
    cup = trimesh.creation.cylinder(0.035, 0.09, sections=64)
    assert is_plain(found_symmetry(mesh(trimesh.util.concatenate([cup, handle]))))
    handle.apply_translation((0.0, 0.0, -0.01))
    assert len(found_symmetry(mesh(trimesh.util.concatenate([cup, handle])))["turns"]) == 2


def test_of_poses_that_look_alike_the_nearest_is_taken() -> None:
    rng = np.random.default_rng(3)
    axis, centre = np.array([0.0, 0.6, 0.8]), np.array([0.01, -0.02, 0.03])
    flip = about(np.array([1.0, 0.0, 0.0]), centre, np.pi)
    for free in ([(axis, centre)], [(np.eye(3)[0], centre), (np.eye(3)[2], centre)], []):
        symmetry = symmetry_of([flip], free)
        near = POSE @ exp_se3(0.01 * rng.normal(size=6))
        turned = near @ flip
        for each, point in free:
            turned = turned @ about(each, point, rng.uniform(-3.0, 3.0))
        (back,) = alike(symmetry, turned[None], POSE)
        distance_m, angle_rad = pose_error(back, POSE)
        wanted_m, wanted_rad = pose_error(near, POSE)
        assert distance_m <= wanted_m + 1e-3
        assert angle_rad <= wanted_rad + 1e-6
        # and it still looks so: what lies on the axis is where it was
        assert (back @ [*centre, 1.0])[:3] == pytest.approx((turned @ [*centre, 1.0])[:3])


def test_what_is_not_exact_of_a_rotation_does_not_grow() -> None:
    symmetry = symmetry_of([], [(np.array([0.0, 0.0, 1.0]), np.zeros(3))])
    pose = POSE.copy()
    pose[:3, :3] *= 1.0 + 1e-12
    for _ in range(100):
        (pose,) = alike(symmetry, (pose @ about(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.1))[None], pose)
    assert np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() < 1e-10


def test_of_a_free_direction_the_prediction_stays_as_it_was() -> None:
    rng = np.random.default_rng(4)
    symmetry = symmetry_of([], [(np.array([0.0, 0.0, 1.0]), np.array([0.02, 0.0, 0.0]))])
    root = rng.normal(size=(2, 6, 6))
    seen, predicted = root @ root.transpose(0, 2, 1)
    told, along = open_to(symmetry), symmetry["free"][0] / np.linalg.norm(symmetry["free"][0])
    assert told @ along == pytest.approx(np.zeros(6), abs=1e-12)
    kept = kept_free(symmetry, seen, predicted)
    assert along @ kept @ along == pytest.approx(along @ predicted @ along)
    assert told @ kept @ told == pytest.approx(told @ seen @ told)
    assert np.linalg.eigvalsh(kept).min() > 0.0


def test_a_covariance_goes_with_the_pose_that_it_is_of() -> None:
    rng = np.random.default_rng(5)
    turn = about(np.array([0.0, 0.0, 1.0]), np.array([0.01, 0.0, 0.0]), np.pi / 2)
    root = rng.normal(size=(6, 6))
    twist = 1e-4 * rng.normal(size=6)
    carried = moved_along(root @ root.T, POSE, POSE @ turn)
    moved = invert(turn) @ exp_se3(twist) @ turn  # the same motion, in the other frame
    there = np.concatenate((moved[:3, 3], [moved[2, 1], moved[0, 2], moved[1, 0]]))
    assert there @ np.linalg.solve(carried, there) == pytest.approx(twist @ np.linalg.solve(root @ root.T, twist), 1e-3)
