"""Kinds of scenes: what lies where on the table, what a finger does to it, and from where a camera looks on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import looks
import numpy as np
from bodies import Body, box, imprecise, random_form, worn
from stage import STEP_S, Setting, Stage, visible_shares

from hierax.nodes.tracking.math.geometry import Floats, exp_se3, exp_so3, looking_down, make_pose

FPS = 30.0
OBJECTS = 6
_SETTLE_S = 1.5
_CANDIDATES = 12  # arrangements of which the best one is taken
_RECORD_S = 4 * STEP_S  # from one recorded state of a moving scene to the next
# Of the kind "taken": the first frame in which one is taken out, after how many the next one is, and for how many.
_TAKEN_FROM, _TAKEN_EVERY, _TAKEN_FRAMES, _OUT_M = 40, 15, 20, 50.0
Path = Callable[[float], Floats]  # world_from_camera at a time in seconds


class NoRoomError(Exception):
    """The things do not find room, or do not stay where they were put."""


@dataclass(frozen=True)
class Scene:
    """A scene in motion, all of it true."""

    bodies: Sequence[Body]
    stage: Stage
    camera: Path
    states: Sequence[Floats]  # of the stage, one each `_RECORD_S`; one of a scene at rest
    still: bool = False  # whether start and camera are told as they are

    def state(self, time_s: float) -> Floats:
        """The stage at a time; before 0 it is at rest."""
        return self.states[min(max(round(time_s / _RECORD_S), 0), len(self.states) - 1)]


def scene(kind: str, seed: int, frames: int, objects: int | None = None) -> Scene:
    """A scene of one of the `KINDS`; equal arguments give equal scenes."""
    rng = np.random.default_rng([seed, *kind.encode(), 66])
    made = None
    while made is None:
        with suppress(NoRoomError):
            made = KINDS[kind](rng, frames, min(objects or OBJECTS, OBJECTS))
    return made


def _scattered(rng: np.random.Generator, frames: int, count: int) -> Scene:
    bodies = [worn(random_form(rng), rng) for _ in range(count)]
    return _at_rest(rng, frames, bodies, _setting(rng, looks.colours(rng, count, 4)), 0.18, 0.025, (30, 48), _open)


def _imprecise(rng: np.random.Generator, frames: int, count: int) -> Scene:
    bodies = [imprecise(random_form(rng), rng) for _ in range(count)]
    return _at_rest(rng, frames, bodies, _setting(rng, looks.colours(rng, count, 4)), 0.17, 0.02, (30, 48), _open)


def _hidden(rng: np.random.Generator, frames: int, count: int) -> Scene:
    bodies = [worn(random_form(rng), rng) for _ in range(count)]
    setting = _setting(rng, looks.colours(rng, count, 3))
    return _at_rest(rng, frames, bodies, setting, 0.1, 0.003, (17, 26), _hiding)


def _low_contrast(rng: np.random.Generator, frames: int, count: int) -> Scene:
    grey = rng.uniform(0.45, 0.65)
    sides = [np.sort(rng.uniform(0.035, 0.095, 3)) for _ in range(count)]
    spread = [first + np.array([0.0, 0.007, 0.014]) for first in sides]
    bodies = [worn(box(rng.permutation(each)), rng) for each in spread]
    setting = _setting(rng, looks.greys(rng, count, grey), looks.plain_table(rng, grey), 0.5)
    return _at_rest(rng, frames, bodies, setting, 0.16, 0.015, (28, 44), _open)


def _tower(rng: np.random.Generator, frames: int, count: int) -> Scene:
    widths = np.sort(rng.uniform(0.045, 0.085, count))[::-1]
    sides = [(width, width * rng.uniform(0.7, 0.95), rng.uniform(0.028, 0.05)) for width in widths]
    bodies = [worn(box(each), rng) for each in sides]
    stage = Stage(bodies, _setting(rng, looks.colours(rng, count, 3)))
    bottoms = [0.0, 0.0, 0.0]
    poses = []
    for at, (body, x_m) in enumerate(zip(bodies, [-0.07, 0.05, -0.07, 0.05, -0.07, 0.16], strict=False)):
        column = (0, 1, 0, 1, 0, 2)[at]
        off = rng.uniform(-0.009, 0.009, 2)
        height = body.real.high - body.real.low
        place = np.array([x_m + off[0], off[1] - 0.03 * column, bottoms[column] + height / 2 + 0.0005])
        bottoms[column] += height + 0.0006
        poses.append(make_pose(_yaw(rng.uniform(-np.pi, np.pi) if at < 2 else rng.uniform(-0.5, 0.5)), place))
    states = _settled(stage, poses)
    if np.abs(stage.poses[:, 2, 3] - np.array(poses)[:, 2, 3]).max() > 0.004:
        raise NoRoomError
    return Scene(bodies, stage, _path(rng, frames, stage.poses, (22, 36)), states)


def _pushed(rng: np.random.Generator, frames: int, count: int) -> Scene:
    """A finger shoves one block along into another, topples a tall one, and the top of a stack."""
    low, high = np.array([(0.05, 0.045, 0.028), (0.065, 0.055, 0.036)])
    sides = [rng.uniform(low, high) * (1.0 - 0.08 * (at % 3)) for at in range(5)]
    tall = np.array([rng.uniform(0.034, 0.042), rng.uniform(0.03, 0.036), rng.uniform(0.075, 0.09)])
    bodies = [worn(box(each), rng) for each in [*sides, tall]][:count]
    stage = Stage(bodies, replace(_setting(rng, looks.colours(rng, count, 3)), finger=True))
    middles, heights = [(0.11, 0.02)] * 3 + [(-0.13, 0.06), (-0.01, 0.065), (-0.06, -0.09)], [s[2] for s in sides]
    bottoms = [0.0, heights[0], heights[0] + heights[1], 0.0, 0.0, 0.0]
    poses = []
    for at, body in enumerate(bodies):
        place = np.array([*(middles[at] + rng.uniform(-0.006, 0.006, 2)), bottoms[at] + 0.0006 * at - body.real.low])
        poses.append(make_pose(_yaw(rng.uniform(-0.3, 0.3)), place))
    top = heights[0] + heights[1] + 0.6 * heights[2]
    way = [
        (0.0, (-0.2, 0.06, 0.015)),
        (0.75, (-0.05 + rng.uniform(-0.01, 0.02), 0.06 + rng.uniform(-0.01, 0.01), 0.015)),
        (0.83, (-0.08, 0.05, 0.05)),
        (1.0, (-0.06, -0.15, 0.065)),
        (1.25, (-0.06, -0.06, 0.065)),
        (1.32, (-0.06, -0.1, 0.1)),
        (1.45, (0.04, 0.02, top)),
        (1.8, (0.04 + rng.uniform(0.09, 0.12), 0.02, top)),
        (2.1, (0.04, -0.1, 0.2)),
        (2.4, (0.0, 0.4, 0.3)),
    ]
    times, tips = np.array([time_s for time_s, _ in way]), np.array([tip for _, tip in way])
    stage.point(tips[0])
    states = _settled(stage, poses)
    for step in range(round((frames / FPS + 0.1) / _RECORD_S)):
        stage.point(np.array([np.interp(step * _RECORD_S, times, axis) for axis in tips.T]))
        stage.let_pass(_RECORD_S)
        states.append(stage.state)
    eye = looking_down(rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(32, 42)), rng.uniform(0.62, 0.8), np.zeros(3))
    return Scene(bodies, stage, lambda _: eye, states, still=True)


def _taken(rng: np.random.Generator, frames: int, count: int) -> Scene:
    """Things that are taken out, one after the other, and put in elsewhere a little later."""
    shown = _scattered(rng, frames, count)
    stage, now = shown.stage, shown.states[0]
    by_frame = [now] * frames
    for number, frame in enumerate(range(_TAKEN_FROM, frames, _TAKEN_EVERY)):
        at = number % count
        back = _put_elsewhere(rng, stage, shown.bodies, now, at)
        height, place = 7 * at + 2, np.s_[7 * at : 7 * at + 7]
        for later in range(frame, frames):
            by_frame[later] = by_frame[later].copy()
            if later < frame + _TAKEN_FRAMES:
                by_frame[later][height] += _OUT_M
            else:
                by_frame[later][place] = back[place]
        now = now.copy()
        now[place] = back[place]
    steps = round(1.0 / FPS / _RECORD_S)
    ahead = steps // 2  # what moves between two pictures does so in the middle
    states = [by_frame[min((step + ahead) // steps, frames - 1)] for step in range(frames * steps)]
    return replace(shown, states=states)


def _put_elsewhere(rng: np.random.Generator, stage: Stage, bodies: Sequence[Body], now: Floats, at: int) -> Floats:
    """A state in which one of the bodies has found room beside the others, which stay where they are."""
    stage.resume(now)
    poses = stage.poses
    others = np.arange(len(bodies)) != at
    for _ in range(60):
        with suppress(NoRoomError):
            tried = [*poses]
            (tried[at],) = _strewn(rng, [bodies[at]], 0.18, 0.025)
            (state,) = _settled(stage, tried)
            if np.abs(stage.poses - poses)[others].max() < 0.001:
                return state
    raise NoRoomError


def _at_rest(
    rng: np.random.Generator,
    frames: int,
    bodies: Sequence[Body],
    setting: Setting,
    radius_m: float,
    gap_m: float,
    elevations_deg: tuple[float, float],
    merit: Callable[[Floats], float],
) -> Scene:
    """Of many arrangements within a disc, each let fall, the one that looks best along the camera's way."""
    stage, found = Stage(bodies, setting), []
    for _ in range(_CANDIDATES if merit is _hiding else 3):
        with suppress(NoRoomError):
            states = _settled(stage, _strewn(rng, bodies, radius_m, gap_m))
            path = _path(rng, frames, stage.poses, elevations_deg)
            shares = [visible_shares(stage, bodies, path(time_s)) for time_s in np.linspace(0.0, frames / FPS, 4)]
            found.append((merit(np.array(shares)), states, path))
    if not found:
        stage.close()
        raise NoRoomError
    _, states, path = max(found, key=lambda each: each[0])
    return Scene(bodies, stage, path, states)


def _open(shares: Floats) -> float:
    """High where much is seen."""
    return float(shares.mean() - 2.0 * (shares < 0.4).mean())


def _hiding(shares: Floats) -> float:
    """High where much is more than half hidden, and nothing is so nearly all the time, or at first."""
    return float(((shares > 0.12) & (shares < 0.5)).mean() - 2.0 * (shares < 0.1).mean() - (shares[0] < 0.2).mean())


def _strewn(rng: np.random.Generator, bodies: Sequence[Body], radius_m: float, gap_m: float) -> list[Floats]:
    """world_from_body of bodies that are about to fall onto one of their sides, apart from one another."""
    poses, taken = [], []
    for body in bodies:
        corners = body.real.corners()
        for _ in range(200):
            turn = _yaw(rng.uniform(-np.pi, np.pi)) @ _tilt(rng, body)
            turned = corners @ turn.T
            way, reach = rng.uniform(-np.pi, np.pi), radius_m * np.sqrt(rng.random())
            place = np.array([reach * np.cos(way), reach * np.sin(way), 0.001 - turned[:, 2].min()])
            around = gap_m / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            print_mm = 1000.0 * ((turned + place)[:, None, :2] + around).reshape(-1, 2)
            hull = cv2.convexHull(print_mm.astype(np.float32))
            if not any(cv2.intersectConvexConvex(hull, other)[0] > 0.0 for other in taken):
                break
        else:
            raise NoRoomError
        taken.append(hull)
        poses.append(make_pose(turn, place))
    return poses


def _tilt(rng: np.random.Generator, body: Body) -> Floats:
    """A rotation that brings one of the body's sides down: a cap, or one of the outline's."""
    if rng.random() < 0.5:
        return np.eye(3)
    outline = body.real.outline
    at = int(rng.integers(len(outline)))
    x, y = outline[(at + 1) % len(outline)] - outline[at]
    level = exp_so3(np.array([0.0, 0.0, -np.arctan2(y, x)]))  # the side's outer normal is now -y
    return exp_so3(np.array([np.pi / 2, 0.0, 0.0])) @ level


def _settled(stage: Stage, poses: Sequence[Floats]) -> list[Floats]:
    """The state in which the bodies come to rest; `NoRoomError` where they do not, or on one another."""
    stage.place(poses)
    stage.let_pass(_SETTLE_S)
    if stage.speed > 0.002 or np.abs(stage.poses[:, :3, 3]).max() > 0.35:
        raise NoRoomError
    return [stage.state]


def _yaw(angle_rad: float) -> Floats:
    return exp_so3(np.array([0.0, 0.0, angle_rad]))


def _path(rng: np.random.Generator, frames: int, poses: Floats, elevations_deg: tuple[float, float]) -> Path:
    """A camera in a hand: it goes to and fro around things, nearer and away, rolls a little, and trembles."""
    target = poses[:, :3, 3].mean(axis=0)
    azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*elevations_deg))
    radius, closer = rng.uniform(0.55, 0.7), rng.uniform(-0.06, 0.06)
    swing, roll = np.radians(rng.uniform(12, 24)), np.radians(rng.uniform(-4, 4))
    rate, phase = 2.0 * np.pi / rng.uniform(3.5, 6.0), rng.uniform(0.0, 2.0 * np.pi, 3)
    rates, phases = rng.uniform(5.0, 26.0, (4, 6)), rng.uniform(0.0, 2.0 * np.pi, (4, 6))
    sizes = rng.standard_normal((4, 6)) * np.array([0.0005] * 3 + [0.0009] * 3)

    def at(time_s: float) -> Floats:
        around = azimuth + swing * np.sin(rate * time_s + phase[0])
        above = elevation + 0.2 * swing * np.sin(0.8 * rate * time_s + phase[1])
        away = radius + closer * np.sin(0.7 * rate * time_s + phase[2])
        tremble = (sizes * np.sin(rates * time_s + phases)).sum(axis=0)
        return looking_down(around, above, away, target) @ make_pose(_yaw(roll), np.zeros(3)) @ exp_se3(tremble)

    return at


def _setting(rng: np.random.Generator, paints: Floats, table: bytes | None = None, contrast: float = 1.0) -> Setting:
    """Two to four lamps around, of which the first is the strongest."""
    lights = []
    for bright in [rng.uniform(0.35, 0.55), *rng.uniform(0.08, 0.28, int(rng.integers(1, 4)))]:
        around, above = rng.uniform(-np.pi, np.pi), rng.uniform(0.7, 1.15)
        flat = np.cos(above)
        way = np.array([flat * np.cos(around), flat * np.sin(around), np.sin(above)])
        lights.append((rng.uniform(1.2, 1.8) * way, contrast * bright))
    pattern = str(rng.choice(looks.TABLES))
    pictures = [looks.paint(rng, paint, contrast == 1.0 and rng.random() < 0.35) for paint in paints]
    ambient = rng.uniform(0.22, 0.34) + 0.3 * (1.0 - contrast)
    return Setting(table or looks.table(rng, pattern), pictures, lights, ambient, rng.uniform(0.0, 0.3))


KINDS: dict[str, Callable[[np.random.Generator, int, int], Scene]] = {
    "scattered": _scattered,
    "hidden": _hidden,
    "tower": _tower,
    "low-contrast": _low_contrast,
    "pushed": _pushed,
    "imprecise": _imprecise,
    "taken": _taken,
}
"""By name; each draws a scene of so many frames and objects."""
