"""N₀ over a BOP scene folder: recorded images, one an epoch."""

import math
from functools import lru_cache
from pathlib import Path

from hierax.nodes.sources.images import Array, ReadAhead
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.datasets.tag import Tag, tag_camera
from hierax.nodes.tracking.schema import Nothing, Picture, SceneBelief
from hierax.runtime import NO_TICK, Tick, World


class BopWorld(World):
    """Shows the frames of a scene in order; nothing acts on it.

    The belief is a `SceneBelief`, see `hierax.nodes.tracking.schema`.

    Args: scene: ``DATASET/SPLIT/000001``. fps: frames per second; an epoch's time is its frame's place divided by it.
        tag: on the table, that tells where the camera is; None: the scene does.
    Raises DataError: a file of the scene is missing or damaged. ValueError: `fps` is not positive."""

    works_ahead = True

    def __init__(self, scene: str, fps: float = 30.0, tag: Tag | None = None) -> None:
        if not 0 < fps < math.inf:
            raise ValueError(f"fps must be positive and finite, got {fps}")
        self._scene = str(scene)
        self._fps = float(fps)
        self._count = len(_scene(self._scene).frames)
        self._camera = None if tag is None else tag_camera(self._scene, tag)

    def initial_belief(self) -> SceneBelief:
        """The first frame is yet to be seen."""
        belief: SceneBelief = {"scene": self._scene, "index": 0}
        return belief if self._camera is None else {**belief, "camera": self._camera.first()}

    def predict(self, context: Nothing, actions: Nothing, belief: SceneBelief, tick: Tick = NO_TICK) -> SceneBelief:
        """Time passes: the next frame; after the last one it stays."""
        index = min(belief["index"] + 1, self._count)
        if self._camera is None or index == self._count:
            return {**belief, "index": index}
        image = _images(self._scene).read(index)
        return {**belief, "index": index, "camera": self._camera.at(index, image, belief["camera"])}

    def time_s(self, belief: SceneBelief, epoch: int) -> float:
        """The frame's place over the frames per second."""
        return float(belief["index"]) / self._fps

    def finished(self, belief: SceneBelief) -> bool:
        """Whether all frames have been seen."""
        return bool(belief["index"] >= self._count)


def frame_seen(belief: SceneBelief) -> tuple[Picture, ...]:
    """φ of a `BopWorld`: the frame and what its camera is known to be; none after the last frame."""
    frames = _scene(belief["scene"]).frames
    if belief["index"] >= len(frames):
        return ()
    frame = frames[belief["index"]]
    image = _images(belief["scene"]).read(belief["index"])
    camera = belief.get("camera", frame.camera)
    return ({"image": image, "camera": camera, "intrinsics": frame.intrinsics, "frame": frame.im_id},)


@lru_cache(maxsize=4)
def _scene(folder: str) -> BopScene:
    return BopScene(folder)


@lru_cache(maxsize=1)
def _images(folder: str) -> ReadAhead[Path, Array]:
    scene = _scene(folder)
    return ReadAhead([frame.image for frame in scene.frames], scene.image)
