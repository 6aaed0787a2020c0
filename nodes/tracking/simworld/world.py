"""The simulated world: cubes on a table, and a camera that swings around them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import schema
from hierax.nodes.tracking.display import world_things
from hierax.nodes.tracking.errors import check_between
from hierax.nodes.tracking.imagery.physics import Motion, Simulator, Solid
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, looking_down, make_pose
from hierax.nodes.tracking.schema import Nothing, Picture, SimBelief
from hierax.nodes.tracking.simworld.scene import develop, draw
from hierax.nodes.tracking.simworld.shapes import Thing, cube, cube_corners
from hierax.runtime import NO_TICK, Step, Tick, Value, World
from hierax.runtime.core.showing import Things

DENSITY_KG_M3 = 600.0
FRICTION = 0.6
MAX_SIDE_PX = 4096
MAX_AMOUNT = 1000  # of noise, in grey levels, and of blur, in pixels
MAX_FPS = 1e6

FOCAL_LENGTH = 0.95  # in widths of the picture
LOOK_AT_M = np.array([0.03, 0.01, 0.04])
RADIUS_M = 0.56
ELEVATION_DEG = 38.0
AZIMUTH_DEG = -93.0
SWING_DEG = 22.0
SWING_PERIOD_S = 4.0

# One cube is drawn over the table by a thread, in front of the others.
DRIVEN_ID = 4
DRIVE_M_S = np.array([0.11, 0.01])
DRIVE_FROM_S, DRIVE_TO_S = 0.4, 1.8


class Placed(NamedTuple):
    """A cube of the scene: its side (m), where its centre is at first (m), its turn about the vertical, its colour."""

    side_m: float
    centre_m: tuple[float, float, float]
    yaw_deg: float
    colour: tuple[int, int, int]


# By id, from 1. The second stands on the first, and they hide one another as the camera goes round; the turns are such
# that no side becomes a sliver, of which one camera cannot tell whether it sees it.
SCENE = (
    Placed(0.080, (0.05, 0.02, 0.0400), 38.0, (196, 52, 44)),
    Placed(0.060, (0.05, 0.02, 0.1100), 55.0, (45, 96, 190)),
    Placed(0.070, (-0.10, 0.06, 0.0350), 50.0, (58, 150, 72)),
    Placed(0.050, (-0.06, -0.085, 0.0250), 51.0, (235, 190, 40)),
    Placed(0.090, (0.17, 0.13, 0.0450), 36.0, (120, 70, 160)),
    Placed(0.045, (0.16, -0.05, 0.0225), 25.0, (226, 120, 40)),
)


class SimWorld(World):
    """Cubes on a table under gravity; one is drawn along. The camera's path is a function of the time.

    The belief is a `SimBelief`, see `hierax.nodes.tracking.schema`; z of the world is up, the table its plane z = 0.

    Args:
        cubes: how many of the scene's cubes, from 1 to 6; frames: after how many the world has finished.
        width, height: of the pictures, in pixels.
        noise: standard deviation of the sensor's noise, in grey levels of 256.
        blur_px: standard deviation of the lens's blur, in pixels; fps: frames per second.
    """

    works_ahead = True

    def __init__(
        self,
        cubes: int = len(SCENE),
        frames: int = 60,
        width: int = 640,
        height: int = 480,
        noise: float = 2.0,
        blur_px: float = 0.7,
        fps: float = 30.0,
    ) -> None:
        bodies = first_bodies(cubes)
        check_pictures(frames, width, height, noise, blur_px)
        if not 0.0 < fps <= MAX_FPS:
            raise ValueError(f"fps is {fps}; expected a positive number, at most {MAX_FPS:g}")
        self._fps = float(fps)
        self._frames = frames
        focal = FOCAL_LENGTH * width
        self._first: SimBelief = {
            "frame": 0,
            "time_s": 0.0,
            "camera": camera_at(0.0),
            "intrinsics": np.array([focal, focal, (width - 1) / 2, (height - 1) / 2]),
            "size": (width, height),
            "noise": float(noise),
            "blur_px": float(blur_px),
            "bodies": bodies,
        }
        sides_m = [body["side_m"] for body in bodies]
        self._solids = [Solid(cube_corners(side), DENSITY_KG_M3 * side**3, FRICTION) for side in sides_m]
        self._simulator = Simulator()

    def initial_belief(self) -> SimBelief:
        """Frame 0: everything at rest."""
        return self._first

    def predict(self, context: Nothing, actions: Nothing, belief: SimBelief) -> SimBelief:
        """The next frame: gravity, contacts and the thread for one frame interval, and the camera moved on."""
        bodies = belief["bodies"]
        motions = [Motion(body["pose"], body["velocity"]) for body in bodies]
        time_s = (belief["frame"] + 1) / self._fps
        drive = drive_at(belief["time_s"])
        drives = {i: drive for i, body in enumerate(bodies) if drive is not None and body["id"] == DRIVEN_ID}
        after = self._simulator.run(self._solids, motions, 1.0 / self._fps, drives)
        moved: tuple[schema.Cube, ...] = tuple(
            {**body, "pose": motion.pose, "velocity": motion.velocity}
            for body, motion in zip(bodies, after, strict=True)
        )
        return {**belief, "frame": belief["frame"] + 1, "time_s": time_s, "camera": camera_at(time_s), "bodies": moved}

    def show(self, step: Step, before: Value) -> Things:
        """The true poses."""
        return world_things(step)

    def time_s(self, belief: SimBelief, epoch: int) -> float:
        """The time of the belief's frame."""
        return float(belief["time_s"])

    def finished(self, belief: SimBelief) -> bool:
        """Whether all frames have been shown."""
        return bool(belief["frame"] >= self._frames)


def check_pictures(frames: int, width: int, height: int, noise: float, blur_px: float) -> None:
    """See that a simulated camera's options are in range; ValueError."""
    check_between(1, 2**53, "a whole number", frames=frames)
    check_between(64, MAX_SIDE_PX, "a whole number", width=width, height=height)
    check_between(0, MAX_AMOUNT, "a number", noise=noise, blur_px=blur_px)


def picture_seen(belief: SimBelief, tick: Tick = NO_TICK) -> tuple[Picture, ...]:
    """φ of the simulated world: the picture that the camera takes, with noise of the tick's generator."""
    return (picture_of(belief, tick),)


def picture_of(belief: SimBelief, tick: Tick, others: Sequence[Thing] = ()) -> Picture:
    """The picture that the camera takes of the bodies, and of other things that nobody knows of."""
    cubes = [Thing(body["pose"], cube(body["side_m"]), body["colour"]) for body in belief["bodies"]]
    picture = draw([*cubes, *others], belief["camera"], belief["intrinsics"], belief["size"])
    image = develop(picture, belief["blur_px"], belief["noise"], tick.rng)
    return {"image": image, "camera": belief["camera"], "intrinsics": belief["intrinsics"], "frame": belief["frame"]}


def camera_at(time_s: float) -> Floats:
    """world_from_camera at a time: it swings around the scene, looking at its middle."""
    phase = 2.0 * np.pi * time_s / SWING_PERIOD_S
    azimuth = np.radians(AZIMUTH_DEG - SWING_DEG * np.cos(phase))
    elevation = np.radians(ELEVATION_DEG + 4.0 * np.sin(phase))
    radius = RADIUS_M - 0.05 * np.sin(phase)
    return looking_down(azimuth, elevation, radius, LOOK_AT_M)


def drive_at(time_s: float) -> Floats | None:
    """The velocity (m/s) of the thread's end at a time, beginning and ending softly; None while it is slack."""
    part = (time_s - DRIVE_FROM_S) / (DRIVE_TO_S - DRIVE_FROM_S)
    if not 0.0 < part < 1.0:
        return None
    return np.asarray(DRIVE_M_S * np.sin(np.pi * part) ** 2)


def first_bodies(cubes: int) -> tuple[schema.Cube, ...]:
    """The first so many cubes of `SCENE`, at rest, as they stand in the belief. Raises ValueError: there are not so
    many."""
    if not 1 <= cubes <= len(SCENE):
        raise ValueError(f"cubes is {cubes}; expected a number from 1 to {len(SCENE)}")
    return tuple(
        {
            "id": number,
            "obj_id": number,
            "side_m": item.side_m,
            "colour": item.colour,
            "pose": make_pose(exp_so3(np.array([0.0, 0.0, np.radians(item.yaw_deg)])), np.array(item.centre_m)),
            "velocity": np.zeros(6),
        }
        for number, item in enumerate(SCENE[:cubes], start=1)
    )
