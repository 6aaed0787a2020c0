"""Sources that are played from their beginning to their end, and leave no frame out: folders and videos."""

import logging
import os
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import SUFFIXES, Array, ReadAhead, read_deep_image
from hierax.nodes.sources.shots import Seen, Shot, Source, ending

_LOG = logging.getLogger(__name__)
_ENDLESS = 1 << 31  # more frames than any video has
_GREY = (b"Y800", b"GREY", b"Y8  ")  # pixel formats of one channel


class Folder(Source):
    """The images of a folder, in the order of their names, numbers in these by their value.

    Args: path: the folder; fps: frames per second. Raises DataError: there is no image in it."""

    def __init__(self, path: Path, fps: float) -> None:
        self.name = str(path)
        self._fps = fps
        found = [each for each in path.iterdir() if each.suffix.lower() in SUFFIXES]
        if not found:
            beside = "; a scene in the BOP format is scene=…" if (path / "scene_camera.json").exists() else ""
            raise DataError(f"{path}: no images in it; expected some of {', '.join(SUFFIXES)}{beside}")
        self._files = sorted(sorted(found), key=_by_number)  # also of 1.png and 01.png one is always the first
        self._images = ReadAhead(self._files, read_deep_image)

    def shot(self, belief: Seen) -> Shot:
        index = belief["index"]
        if index >= len(self._files):
            return ending(belief)
        return Shot(index, self._images.read(index), index / self._fps, place=str(self._files[index]))


class Video(Source):
    """The frames of a video file. It is decoded from its beginning on, as decoders seek to frames beside the right one.

    Args: path: the file; fps: frames per second, whatever the file says. Raises DataError: it cannot be opened."""

    def __init__(self, path: Path, fps: float) -> None:
        self.name = str(path)
        self._place = str(path.absolute())  # of a relative one FFmpeg takes what a colon follows for a protocol
        self._fps = fps
        self._is_short = False
        self._begin()
        self._frames = ReadAhead(range(_ENDLESS), self._decoded)

    def shot(self, belief: Seen) -> Shot:
        index = belief["index"]
        image = self._frames.read(index)
        return ending(belief) if image is None else Shot(index, image, index / self._fps)

    def _begin(self) -> None:
        quiet()
        self._capture = cv2.VideoCapture(self._place, cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise DataError(f"{self.name}: cannot be opened; expected a video, a recording, or a folder of images")
        self._grey = is_grey(self._capture)
        self._next = 0

    def _decoded(self, index: int) -> Array | None:
        """A frame; None after the last one. Called in one thread alone."""
        if index < self._next:
            self._capture.release()
            self._begin()
        while self._next < index and self._capture.grab():
            self._next += 1
        good, image = self._capture.read() if self._next == index else (False, None)
        self._next += good
        if good and image is not None:
            return colours(image, self._grey)
        told, rate = (self._capture.get(each) for each in (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FPS))
        if told < _ENDLESS and self._next + max(rate, 1.0) < told:  # containers estimate, but not by a second
            what = f"ends, or is damaged, after {self._next} frames; expected {told:.0f}, as it says itself"
            raise DataError(f"{self.name}: {what}")
        if self._next == 0:
            raise DataError(f"{self.name}: is damaged; expected a video of which a frame can be decoded")
        if told < _ENDLESS and self._next + 1 < told and not self._is_short:
            self._is_short = True  # told once: what is read ahead ends again and again
            _LOG.warning("%s: ends after %d frames; it says itself that it has %.0f", self.name, self._next, told)
        return None


def quiet() -> None:
    """Have OpenCV keep its warnings of videos to itself: what they come to is told in an error."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


def is_grey(capture: Any) -> bool:
    """Whether what is opened has one channel; OpenCV gives three then, too, all alike."""
    return int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)).to_bytes(4, "little", signed=True) in _GREY


def colours(image: Array, grey: bool) -> Array:
    """A frame of OpenCV's as nodes have it: gray (h, w) or RGB (h, w, 3)."""
    if image.ndim == 2:
        return image
    return np.ascontiguousarray(image[:, :, 0] if grey else image[:, :, 2::-1])


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]
