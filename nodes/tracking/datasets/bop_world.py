"""N₀ over a BOP scene folder: recorded images, one an epoch."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path

from hierax.nodes.tracking.datasets.bop import BopScene, read_image
from hierax.nodes.tracking.datasets.tag import Tag, tag_camera
from hierax.nodes.tracking.math.geometry import Array
from hierax.nodes.tracking.schema import Nothing, Picture, SceneBelief
from hierax.runtime import NO_TICK, Tick, World

AHEAD = 8  # how many images are read ahead at most


class BopWorld(World):
    """Shows the frames of a scene in order; nothing acts on it.

    The belief is a `SceneBelief`, see `hierax.nodes.tracking.schema`.

    Args: scene: ``DATASET/SPLIT/000001``. fps: frames per second; an epoch's time is its frame's place divided by it.
        tag: on the table, that tells where the camera is; None: the scene does.
    Raises DataError: a file of the scene is missing or damaged. ValueError: `fps` is not positive.
    """

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


class ReadAhead:
    """Images in an order, of which the next, at most `depth`, are read in a thread while one is used. What `read`
    returns or raises does not depend on it."""

    def __init__(self, paths: Sequence[Path], depth: int = AHEAD, read: Callable[[Path], Array] = read_image) -> None:
        self._read = read
        self._paths = paths
        self._depth = depth
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="read-ahead")
        self._begun: dict[int, Future[Array]] = {}

    def read(self, index: int) -> Array:
        """The image at an index. Raises DataError: it is missing or damaged, or of another size than the others."""
        ahead = range(index, min(index + 1 + self._depth, len(self._paths)))
        for at in [at for at in self._begun if at not in ahead]:
            self._begun.pop(at).cancel()
        for at in ahead:
            if at not in self._begun:
                self._begun[at] = self._thread.submit(self._read, self._paths[at])
        return self._begun[index].result()


@lru_cache(maxsize=4)
def _scene(folder: str) -> BopScene:
    return BopScene(folder)


@lru_cache(maxsize=1)
def _images(folder: str) -> ReadAhead:
    scene = _scene(folder)
    return ReadAhead([frame.image for frame in scene.frames], read=scene.image)
