"""Things that are knocked, one after the other: they slide, turn and topple faster than they can be followed.

Nothing is seen of what knocks them, as of a finger that flicks. The motion is pybullet's, done beforehand."""

from collections.abc import Sequence

import numpy as np

from hierax.nodes.tracking.generator.camera import FPS
from hierax.nodes.tracking.imagery.physics import Motion, Simulator, Solid
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.simworld.shapes import Thing

FIRST, EVERY = 8, 16  # the first frame in which one is knocked, and after how many the next one is
_SPEEDS_M_S = (0.4, 1.2)
# How fast it is turned besides, for the speed of its middle over half of its height: 1 has its foot stand still.
_TURNING = (0.2, 1.0)
_MASS_KG = 0.1


def knocked(things: Sequence[Thing], rng: np.random.Generator, frames: int) -> Floats:
    """world_from_object of things (frames, n, 4, 4), which at first stand where they are."""
    solids = [Solid(thing.shape.mesh.vertices, _MASS_KG) for thing in things]
    motions = [Motion(thing.pose, np.zeros(6)) for thing in things]
    simulator, poses = Simulator(), []
    order = rng.permutation(len(things))
    for frame in range(frames):
        poses.append([motion.pose for motion in motions])
        number, due = divmod(frame - FIRST, EVERY)
        if due == 0 <= number:
            at = order[number % len(order)]
            motions[at] = _flicked(solids[at], motions[at], rng)
        motions = simulator.run(solids, motions, 1.0 / FPS)
    return np.array(poses)


def _flicked(solid: Solid, motion: Motion, rng: np.random.Generator) -> Motion:
    """What it does when something hits it from a side, above its middle."""
    turn, speed = rng.uniform(-np.pi, np.pi), rng.uniform(*_SPEEDS_M_S)
    way = np.array([np.cos(turn), np.sin(turn), 0.0])
    half = float(np.ptp(solid.vertices @ motion.pose[2, :3])) / 2.0
    spin = rng.uniform(*_TURNING) * speed / half * np.cross([0.0, 0.0, 1.0], way)
    offset = motion.pose[:3, :3] @ solid.centre
    return Motion(motion.pose, np.concatenate((speed * way - np.cross(spin, offset), spin)))
