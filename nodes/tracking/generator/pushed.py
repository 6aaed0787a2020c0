"""Scenes in which a rod pushes things about: one slides behind a screen and out again, another topples.

The motion is pybullet's, done beforehand. The rod belongs to nobody's model."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.generator.camera import FPS
from hierax.nodes.tracking.generator.stock import LYING, Item, colours
from hierax.nodes.tracking.imagery.physics import Bullet, box_shape, create_body, hull_shape, pose_of, prepare
from hierax.nodes.tracking.math.geometry import (
    Array,
    Floats,
    Size,
    exp_so3,
    invert,
    looking_down,
    make_pose,
    project,
    quaternion_of,
)
from hierax.nodes.tracking.simworld.raster import visible_shares
from hierax.nodes.tracking.simworld.shapes import Thing, box, regular, wedge

MOST_PX = 9.0  # the camera stands so far away that nothing moves by more than about this from frame to frame
HIDDEN_FRAMES = 22  # for how many frames the screen hides what slides behind it
_STEPS = 16
_DENSITY_KG_M3 = 500.0
_ROD_M = (0.007, 0.36)
_ROD_FORCE_N = 60.0
_GONE = 0.1
_RADII_M = (0.62, 1.05)  # the camera's least and greatest distance


class _Plan(NamedTuple):
    """Things where they stand at first, and the rod's way."""

    things: list[Thing]  # the objects; the screen is 0, what slides behind it is 1
    rod: Thing  # the rod at its first place
    times_s: Floats  # times_s, tips_m: (n,) and (n, 3): when the rod's tip is where
    tips_m: Floats


def pushed(
    rng: np.random.Generator, frames: int, intrinsics: Array, size: Size
) -> tuple[list[Thing], Floats, Floats, Thing, Floats]:
    """A scene of six objects, see the module, seen with fx, fy, cx, cy in pictures (w, h): the objects, their poses
    (frames, 6, 4, 4), the camera's (frames, 4, 4), the rod, and its poses (frames, 4, 4)."""
    plan = _planned(rng)
    poses, rods = _simulated(plan, frames)
    azimuth_deg, elevation_deg = -90.0 + rng.uniform(-4.0, 4.0), rng.uniform(26.0, 30.0)
    target = np.array([0.0, 0.02, 0.03])

    def camera(radius_m: float) -> Floats:
        return looking_down(np.radians(azimuth_deg), np.radians(elevation_deg), radius_m, target)

    trial_m = 0.8
    fastest = _fastest_px(poses, camera(trial_m), intrinsics)
    eye = camera(float(np.clip(trial_m * fastest / MOST_PX, *_RADII_M)))
    screen = _fitting_screen(plan.things, poses, eye, intrinsics, size)
    return [screen, *plan.things[1:]], poses, np.repeat(eye[None], frames, axis=0), plan.rod, rods


def _planned(rng: np.random.Generator) -> _Plan:
    paints = colours(rng, 6)
    side = float(rng.choice([-1.0, 1.0]))

    def near(x_m: float, y_m: float, spread_m: float = 0.008) -> tuple[float, float]:
        off = rng.uniform(-spread_m, spread_m, 2)
        return side * x_m + off[0], y_m + off[1]

    def yaw() -> float:
        return float(rng.uniform(-0.25, 0.25))

    def block(paint: tuple[int, int, int], *sides: tuple[float, float]) -> Item:
        return Item(box([rng.uniform(*side) for side in sides]), np.eye(3), paint)

    slider = block(paints[1], (0.04, 0.05), (0.045, 0.055), (0.033, 0.04))
    # It is thin in the direction in which it is to fall: over the flat one, or free of it.
    over = rng.random() < 0.5
    thin, broad = rng.uniform(0.034, 0.04), rng.uniform(0.044, 0.05)
    pillar = Item(box((*((broad, thin) if over else (thin, broad)), rng.uniform(0.078, 0.09))), np.eye(3), paints[2])
    flat = block(paints[3], (0.06, 0.075), (0.055, 0.065), (0.03, 0.036))
    roof = Item(wedge(rng.uniform(0.06, 0.075), rng.uniform(0.045, 0.055), rng.uniform(0.05, 0.07)), LYING, paints[4])
    rest = block(paints[5], (0.06, 0.07), (0.04, 0.05), (0.05, 0.06))
    screen = Item(box((0.14, 0.03, 0.11)), np.eye(3), paints[0])
    start_x, row_y = -0.16, 0.075
    tall_x, tall_y = 0.165, -0.015
    fall = np.array([0.0, -1.0]) if over else np.array([1.0, 0.0])
    things = [
        screen.placed(0.0, -0.035, 0.0),
        slider.placed(side * start_x, row_y, yaw()),
        pillar.placed(*near(tall_x, tall_y), yaw()),
        flat.placed(*near(tall_x + 0.003, tall_y - 0.085), yaw()),
        roof.placed(*near(-0.165, -0.06), yaw()),
        rest.placed(*near(0.02, 0.185), float(rng.uniform(-np.pi, np.pi))),
    ]
    tall = np.array([tall_x, tall_y])
    speed = rng.uniform(0.12, 0.145)
    way = [
        (0.0, (start_x - 0.075, row_y, 0.018)),
        (0.2, (start_x - 0.045, row_y, 0.018)),
        (0.2 + 0.265 / speed, (start_x + 0.22, row_y, 0.018)),
        (0.35 + 0.265 / speed, (start_x + 0.20, row_y, 0.03)),
        (0.65 + 0.265 / speed, (*(tall - 0.07 * fall), 0.13)),
        (0.8 + 0.265 / speed, (*(tall - 0.055 * fall), 0.062)),
        (1.25 + 0.265 / speed, (*(tall + 0.02 * fall), 0.062)),
        (1.4 + 0.265 / speed, (*(tall - 0.02 * fall), 0.14)),
        (1.85 + 0.265 / speed, (-0.235, -0.05, 0.12)),
        (1.95 + 0.265 / speed, (-0.235, -0.06, 0.02)),
        (2.5 + 0.265 / speed, (-0.1, -0.07, 0.02)),
        (9.0, (-0.1, -0.07, 0.02)),
    ]
    times = np.array([time_s for time_s, _ in way])
    tips = np.array([tip for _, tip in way]) * np.array([side, 1.0, 1.0])
    lean = exp_so3(np.array([-0.35, side * rng.uniform(-0.5, -0.3), 0.0]))
    radius, length = _ROD_M
    rod = Thing(make_pose(lean, tips[0] + lean[:, 2] * length / 2), regular(8, radius, length), (58, 56, 60))
    return _Plan(things, rod, times, tips)


def _simulated(plan: _Plan, frames: int) -> tuple[Floats, Floats]:
    """world_from_object of things (frames, n, 4, 4) and rod (frames, 4, 4)."""
    bullet = Bullet()
    prepare(bullet, 1.0 / (FPS * _STEPS), [5.0] * 3, 0.7)
    handles = [_created(bullet, thing) for thing in plan.things]
    # What is screwed to the table would not be pushed; the screen is heavy instead.
    bullet.changeDynamics(handles[0], -1, mass=5.0)
    rod = _created(bullet, plan.rod)
    start = plan.rod.pose[:3, 3].tolist()
    hand = bullet.createConstraint(rod, -1, -1, -1, bullet.JOINT_FIXED, [0, 0, 0], [0, 0, 0], start)
    turn = quaternion_of(plan.rod.pose[:3, :3]).tolist()
    from_tip = plan.rod.pose[:3, 3] - plan.tips_m[0]
    poses, rods = [], []
    for frame in range(frames):
        poses.append([pose_of(bullet, handle) for handle in handles])
        rods.append(pose_of(bullet, rod))
        for step in range(_STEPS):
            place = _tip_at(plan, (frame + (step + 1) / _STEPS) / FPS) + from_tip
            bullet.changeConstraint(hand, place.tolist(), jointChildFrameOrientation=turn, maxForce=_ROD_FORCE_N)
            bullet.stepSimulation()
    return np.array(poses), np.array(rods)


def _created(bullet: Bullet, thing: Thing) -> int:
    vertices = thing.shape.mesh.vertices
    half = np.ptp(vertices, axis=0) / 2
    is_box = len(vertices) == 8 and np.allclose(np.abs(vertices), half)
    shape = box_shape(bullet, half.tolist()) if is_box else hull_shape(bullet, vertices)
    return create_body(bullet, shape, _DENSITY_KG_M3 * float(np.prod(2.0 * half)), 0.6, thing.pose)


def _tip_at(plan: _Plan, time_s: float) -> Floats:
    return np.array([np.interp(time_s, plan.times_s, axis) for axis in plan.tips_m.T])


def _fastest_px(poses: Floats, camera: Floats, intrinsics: Array) -> float:
    """The farthest that the middle of a thing moves in the picture from one frame to the next."""
    centres = poses[:, :, :3, 3] - camera[:3, 3]
    pixels = project(centres @ invert(camera)[:3, :3].T, intrinsics)
    return float(np.linalg.norm(np.diff(pixels, axis=0), axis=-1).max(initial=0.0))


def _fitting_screen(things: Sequence[Thing], poses: Floats, camera: Floats, intrinsics: Array, size: Size) -> Thing:
    """The screen, so wide that what slides behind it is gone for `HIDDEN_FRAMES` frames, or nearly."""
    slider, height = things[1], float(np.ptp(things[0].shape.mesh.vertices, axis=0)[2])
    low, high, half = 0.06, 0.22, (size[0] // 2, size[1] // 2)
    for _ in range(7):
        width = (low + high) / 2
        screen = things[0]._replace(shape=box((width, 0.03, height)))
        sliding = ([slider._replace(pose=pose), screen] for pose in poses[:, 1])
        gone = sum(visible_shares(each, camera, intrinsics / 2, half)[0] < _GONE for each in sliding)
        low, high = (low, width) if gone > HIDDEN_FRAMES else (width, high)
    return screen
