"""Cameras of generated scenes: how a hand moves one, and how wrong what is said of it may be."""

from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, exp_se3, looking_down

FPS = 30.0
DRIFT_M, DRIFT_DEG = 0.008, 1.0  # how far the reported camera drifts from the true one at most
JITTER_M, JITTER_DEG = 0.001, 0.1  # standard deviation, in each axis and frame, of what comes on top
_TREMBLE_M, _TREMBLE_DEG = 0.0006, 0.06
_DRIFT_WIDTH_FRAMES = 8.0


class Swing(NamedTuple):
    """A camera's path around what it looks at."""

    azimuth_deg: float  # azimuth_deg, elevation_deg: around which it swings
    elevation_deg: float
    radius_m: tuple[float, float]  # its distance at the beginning and at the end
    swing_deg: float  # how far to each side
    period_s: float  # of the swinging
    phase: float  # of the swinging at the beginning, rad


def camera_path(swing: Swing, target_m: Array, frames: int, rng: np.random.Generator) -> Floats:
    """world_from_camera (frames, 4, 4) along a path around what it looks at, with a hand's tremble."""
    time_s = np.arange(frames) / FPS
    tremble = np.zeros((frames, 6))
    for frequency_hz in rng.uniform(0.8, 4.0, 5):
        scale = np.array([_TREMBLE_M] * 3 + [np.radians(_TREMBLE_DEG)] * 3)
        turn = rng.uniform(0.0, 2.0 * np.pi, 6)
        tremble += scale * rng.standard_normal(6) * np.sin(2.0 * np.pi * frequency_hz * time_s[:, None] + turn)
    progress = np.arange(frames) / max(1, frames - 1)
    poses = [_looking(swing, target_m, t, part) for t, part in zip(time_s, progress, strict=True)]
    return np.array([pose @ exp_se3(off) for pose, off in zip(poses, tremble, strict=True)])


def reported_path(path: Floats, rng: np.random.Generator) -> Floats:
    """What a drifting and jittering camera's pose is said to be in each frame, (frames, 4, 4)."""
    frames = len(path)
    walk = np.cumsum(np.cumsum(rng.standard_normal((frames + 60, 6)), axis=0), axis=0)
    # The second sum's trend would carry all of it away: what is left of it by a wider mean is the drift.
    walk = _smooth(walk - _smooth(walk, 5.0 * _DRIFT_WIDTH_FRAMES), _DRIFT_WIDTH_FRAMES)[30 : 30 + frames]
    walk -= walk[0]
    limits = (DRIFT_M, np.radians(DRIFT_DEG))
    for part, limit in zip((np.s_[:, :3], np.s_[:, 3:]), limits, strict=True):
        farthest = np.linalg.norm(walk[part], axis=1).max()
        walk[part] *= limit / farthest if farthest > 0.0 else 0.0
    jitter = rng.standard_normal((frames, 6)) * np.array([JITTER_M] * 3 + [np.radians(JITTER_DEG)] * 3)
    return np.array([pose @ exp_se3(a + b) for pose, a, b in zip(path, walk, jitter, strict=True)])


def _smooth(series: Floats, width: float) -> Floats:
    reach = int(3 * width)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    padded = np.pad(series, ((reach, reach), (0, 0)), mode="edge")
    columns = [np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T]
    return np.stack(columns, axis=1)


def _looking(swing: Swing, target_m: Array, time_s: float, progress: float) -> Floats:
    phase = swing.phase + 2.0 * np.pi * time_s / swing.period_s
    azimuth = np.radians(swing.azimuth_deg + swing.swing_deg * np.sin(phase))
    elevation = np.radians(swing.elevation_deg + 0.15 * swing.swing_deg * np.sin(1.3 * phase))
    near, far = swing.radius_m
    eased = progress * progress * (3.0 - 2.0 * progress)
    radius = near + (far - near) * eased
    return looking_down(azimuth, elevation, radius, target_m)
