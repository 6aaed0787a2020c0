"""The frames of a recording: what its world showed, epoch by epoch."""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.shots import MAX_STAMP_NS, Seen, Shot, Source, ending
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.trace import EpochTrace
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import OBSERVATIONS

_LOG = logging.getLogger(__name__)


class RecordedFrames(Source):
    """What the world of a recording showed of a camera: any world whose observations hold ``image``, ``camera``,
    ``intrinsics`` and ``frame``. An epoch in which it showed nothing is one here, too. What it lacks,
    as where it was cut off, has a line in the log.

    Args: path: the recording. Raises DataError: it cannot be read, lacks an observation, shows no pictures, or has no
    epochs."""

    straight = True

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        try:
            self._recording = Recording.open(path)
        except HieraxError as error:
            raise DataError(str(error)) from error
        if self._recording.loss:
            _LOG.warning("%s: %s", self.name, self._recording.loss)
        self._next = 0
        self._shots = self._read()

    def shot(self, belief: Seen) -> Shot:
        index = belief["index"]
        if index < self._next:
            self._next, self._shots = 0, self._read()
        while True:
            shot = next(self._shots, None)
            if shot is None:
                return ending(belief)
            self._next += 1
            if self._next > index:
                return shot if shot.image is not None else shot._replace(frame=belief["frame"])

    def _read(self) -> Iterator[Shot]:
        epoch = None
        try:
            for epoch in self._recording.epochs():
                yield shot_of(self.name, epoch)
        except DataError:
            raise
        except (HieraxError, SchemaError) as error:
            raise DataError(str(error)) from error
        if epoch is None:
            raise DataError(f"{self.name}: has no epochs; expected some to show")


def shot_of(recording: str, epoch: EpochTrace) -> Shot:
    """What a recording's world showed in an epoch. Raises DataError, as `RecordedFrames`."""
    world, time_s, where = epoch.roster.world, epoch.time_s or 0.0, f"{recording}: epoch {epoch.epoch}"
    shown = [epoch.elements(OBSERVATIONS, *edge.pair) for edge in epoch.roster.edges if edge.lower == world]
    if not shown or shown[0] is None:
        raise DataError(f"{where}: lacks what {world} showed; expected its observations")
    if not shown[0]:
        return Shot(-1, None, time_s)
    (picture, *_) = shown[0]
    try:
        image, frame = picture["image"], picture["frame"]
        camera, intrinsics = (np.asarray(picture[each], np.float64) for each in ("camera", "intrinsics"))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DataError(f"{where}: {world} showed no picture; expected image, camera, intrinsics and frame") from error
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16) or type(frame) is not int:
        raise DataError(f"{where}: image: expected 8 or 16 bits a pixel, and a frame's number")
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)) or not image.size:
        raise DataError(f"{where}: image: expected gray (h, w) or RGB (h, w, 3), got {image.shape}")
    if camera.shape != (4, 4) or intrinsics.shape != (4,) or not np.isfinite([*camera.flat, *intrinsics]).all():
        raise DataError(f"{where}: camera, intrinsics: expected 4 × 4 and 4 finite numbers")
    header = picture.get("header")
    if header is not None and not _is_header(header):
        raise DataError(f"{where}: header: expected stamp_ns and frame_id")
    return Shot(frame, image, time_s, camera=camera, intrinsics=intrinsics, header=header)


def _is_header(header: object) -> bool:
    told = (header.get("stamp_ns"), header.get("frame_id")) if isinstance(header, dict) else (None, None)
    return type(told[0]) is int and 0 <= told[0] < MAX_STAMP_NS and type(told[1]) is str
