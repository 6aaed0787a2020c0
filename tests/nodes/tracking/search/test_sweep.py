"""Where an object may be of which nothing is known: its faces stand out, whatever edges there are around."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.imagery.proposals import Proposer, places_on
from hierax.nodes.tracking.math.batched import pixels_of
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, invert, looking_down, make_pose, transform
from hierax.nodes.tracking.model.mesh import Mesh, box_mesh
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.schema import Sweep
from hierax.nodes.tracking.search.sweep import Proposed, maps_of, stands_out, swept, uncovered

SIZE = (320, 240)
INTRINSICS = np.array([300.0, 300.0, 159.5, 119.5])
CAMERA = looking_down(0.4, 0.75, 0.45, np.zeros(3))
SIDES_M = (0.05, 0.07, 0.035)
POSE = make_pose(exp_so3(np.array([0.0, 0.0, 0.5])), np.array([0.01, -0.02, SIDES_M[2] / 2]))
TABLE, SIDES = np.array([120.0, 150.0, 110.0]), np.array([[60.0, 35.0, 70.0], [45.0, 25.0, 55.0], [90.0, 60.0, 100.0]])


def picture(mesh: Mesh, seed: int) -> Array:
    """A dark box among tiles whose edges are stronger than its own, in the noise of little light."""
    rng = np.random.default_rng(seed)
    tiles = cv2.resize(rng.choice([-45.0, 0.0, 45.0], (12, 16)), SIZE, interpolation=cv2.INTER_NEAREST)
    image = (TABLE + tiles[..., None]).astype(np.float32)
    seen = transform(invert(CAMERA) @ POSE, mesh.vertices)
    for corners in seen[mesh.faces]:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        if normal @ corners[0] < 0:
            axis = int(np.abs((CAMERA @ POSE)[:3, :3].T @ normal).argmax())
            cv2.fillConvexPoly(image, np.rint(pixels_of(corners, INTRINSICS)).astype(np.int32), SIDES[axis].tolist())
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0.0, 9.0, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def sweep_of(mesh: Mesh) -> Sweep:
    proposer = Proposer(LayerRenderer(shape_of(mesh.vertices, mesh.faces)))
    places = places_on(CAMERA, INTRINSICS, SIZE, 0.0, None, 10_000)
    templates = proposer.templates(CAMERA, np.zeros(3), INTRINSICS)
    return {"id": 1, "places": invert(CAMERA) @ places, "templates": templates, "rough_m": 0.0}


def off_m(poses: Floats, mesh: Mesh) -> Floats:
    """(n,) how far the farthest corner is from the nearest of the true pose's."""
    true = transform(invert(CAMERA) @ POSE, mesh.vertices)
    every = np.stack([transform(pose, mesh.vertices) for pose in poses])
    found: Floats = np.linalg.norm(every[:, :, None] - true, axis=-1).min(axis=2).max(axis=1)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_a_box_is_proposed_whose_edges_are_weaker_than_those_around(seed: int) -> None:
    mesh = box_mesh(list(SIDES_M))
    maps, sweep = maps_of(smoothed(picture(mesh, seed))), sweep_of(mesh)
    found: Proposed = swept(maps, sweep, INTRINSICS)
    assert off_m(found.poses[:4], mesh).min() < 0.012, f"seed {seed}"
    # What lies on something that is seen says nothing.
    outline = pixels_of(transform(invert(CAMERA) @ POSE, mesh.vertices), INTRINSICS)
    hidden = maps.without([outline])
    controls = [sweep["templates"][number]["controls"] for number in found.templates[:1]]
    here, gone = (stands_out(each, found.poses[:1], controls, INTRINSICS)[0] for each in (maps, hidden))
    assert here > 2.0 > abs(gone)


def test_what_lies_on_something_that_is_seen_or_outside_of_the_image_is_not_expected_to_be_seen() -> None:
    mesh = box_mesh(list(SIDES_M))
    maps, pose = maps_of(smoothed(picture(mesh, 0))), invert(CAMERA) @ POSE
    template = sweep_of(mesh)["templates"][0]["controls"]
    pixels = pixels_of(transform(pose, template["points"]), INTRINSICS)
    left = pixels[:, 0] < np.median(pixels[:, 0])
    corners = np.array([[0.0, 0.0], [np.median(pixels[:, 0]), 0.0], [np.median(pixels[:, 0]), 239.0], [0.0, 239.0]])
    (alone,), (beside,) = (
        uncovered(each, pose[None], [template], INTRINSICS) for each in (maps, maps.without([corners]))
    )
    assert np.array_equal(alone["visible"], template["visible"])
    assert not beside["visible"][left].any()
    assert beside["visible"][pixels[:, 0] > np.median(pixels[:, 0]) + 4.0].all()
    beyond = make_pose(np.eye(3), np.array([0.4, 0.0, 0.0])) @ pose
    assert not uncovered(maps, beyond[None], [template], INTRINSICS)[0]["visible"].any()


def test_what_has_no_control_points_is_proposed_nowhere_and_stands_out_nowhere() -> None:
    mesh = box_mesh(list(SIDES_M))
    maps, sweep = maps_of(smoothed(picture(mesh, 0))), sweep_of(mesh)
    nothing = {name: each[:0] for name, each in sweep["templates"][0]["controls"].items()}
    assert stands_out(maps, sweep["places"][:1], [nothing], INTRINSICS) == [-np.inf]  # type: ignore[list-item]
    empty = {**sweep["templates"][0], "controls": nothing}
    beside: Sweep = {**sweep, "templates": (*sweep["templates"], empty)}  # type: ignore[typeddict-item]
    found, without = (swept(maps, each, INTRINSICS) for each in (beside, sweep))
    assert np.array_equal(found.poses, without.poses)
