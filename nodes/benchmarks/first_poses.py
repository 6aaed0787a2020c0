"""``hierax bench tracking --start search``: objects whose first poses nobody tells, beside the truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hierax.nodes.benchmarks.tracking import CONTEXT, SEARCH, Scene, Tell, Tracked, track
from hierax.nodes.tracking.evaluation.scoring import RIGHT, ObjectErrors, frames_until, is_astray

FRAME = 30  # at which poses are judged; of a scene that ends before it, the last one
SEEN = 0.6  # of objects that are seen by this share at least


@dataclass(frozen=True)
class Starts:
    """Scenes of one name, tracked without first poses."""

    name: str  # of the scenes
    seen: int  # objects that are seen well enough in frame `FRAME`
    right: int  # of those, how many are right by 5 mm and 5 degrees there
    given: int  # poses of all objects that are given there
    wrong: int  # of those, how many are off by more than 20 mm or 10 degrees
    object_ms: float  # the processor's time up to the end for each object, of all nodes but the world, median of scenes
    gone: Sequence[int | None]  # of each time that an object was taken out, after how many frames no pose was given
    found: Sequence[int | None]  # of each time that one was put in again, after how many frames it was right


def bench_starts(scenes: Sequence[Scene], settings: Sequence[str], folder: Path, told: Tell) -> list[Starts]:
    """Track scenes without first poses, with further settings ``path=value`` of the deployment; results files go into
    the folder. Raises HieraxError: a scene cannot be read, or a node failed."""
    errors: dict[str, list[ObjectErrors]] = {}
    times: dict[str, list[float]] = {}
    for scene in scenes:
        told(f"{scene.name}, seed {scene.seed}: looking for its objects")
        tracked = track(scene, CONTEXT, [SEARCH, *settings], folder)
        errors.setdefault(scene.name, []).extend(tracked.errors)
        times.setdefault(scene.name, []).append(_object_ms(tracked))
    return [_starts(name, every, float(np.median(times[name]))) for name, every in errors.items()]


def _object_ms(tracked: Tracked) -> float:
    frames = max(len(item.frames) for item in tracked.errors)
    return frames * (tracked.stage_ms["arm"] + tracked.stage_ms["spatial"]) / len(tracked.errors)


def _starts(name: str, errors: Sequence[ObjectErrors], object_ms: float) -> Starts:
    at = [(item, min(int(np.searchsorted(item.frames, FRAME)), len(item.frames) - 1)) for item in errors]
    seen = [(item, frame) for item, frame in at if item.visible[frame] >= SEEN]
    right = sum(bool(item.within(RIGHT)[frame]) for item, frame in seen)
    distance = np.array([item.distance_mm[frame] for item, frame in at])
    angle = np.array([item.angle_deg[frame] for item, frame in at])
    given = ~np.isnan(distance)
    wrong = is_astray(distance, angle)
    gone = [frames for item in errors for frames in changes(item, False)]
    found = [frames for item in errors for frames in changes(item, True)]
    return Starts(name, len(seen), right, int(given.sum()), int(wrong.sum()), object_ms, gone, found)


def changes(item: ObjectErrors, back: bool) -> list[int | None]:
    """Of each time that an object is no longer seen at all, or is seen again, after how many frames that is said. None
    of one that is not said before the next change."""
    if back:
        return frames_until(item.visible > 0.0, item.within(RIGHT))
    return frames_until(~(item.visible > 0.0), np.isnan(item.distance_mm))
