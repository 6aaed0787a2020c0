"""Pictures of a tracking run: expected and corrected edges over the camera's images, and a video of them."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.sources.files import UNFINISHED, DataError
from hierax.nodes.sources.images import read_image, write_picture
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats, invert, project, transform
from hierax.nodes.tracking.schema import AnyArmBelief, PaperObject, TrackedObject
from hierax.runtime import Probe, Step

VIDEO_FILE = "video.mp4"
PICTURES_FOLDER = "pictures"
CONTACT_SHEET = "contact-sheet.png"

# RGB of edges where they were expected, and where the arm's correction puts them.
EXPECTED = (235, 60, 50)
CORRECTED = (60, 235, 80)

_EXPECTED_PX, _CORRECTED_PX = 2, 1  # widths: where both are at one place, both are seen
_STATUSES = ("tracked", "expected", "lost")
_WHITE = (255, 255, 255)
_STRIP_PX = 24
_SHIFT = 4
_SHEET_COLUMNS = 3
_SHEET_PICTURES = 9
_SHEET_WIDTH_PX = 480
_PICTURE = re.compile(r"frame-(\d{6,})\.png")
_EPOCHS_AGAIN = 4  # how many of the last epochs can be told again with their expected edges still known


class _Shown(NamedTuple):
    """What is seen in one epoch."""

    frame: int
    image: Array
    expected: AnyArmBelief | None
    corrected: AnyArmBelief


class Pictures(Probe):
    """Draws the arm's edges over the camera's images, into ``pictures/`` in the output folder.

    Red are the edges where they were expected, before the image was seen; green where the correction puts them; objects
    that are not tracked have no green. The first frame, every `every`-th and the last one are written, and a contact
    sheet of them at the end; with `video` every frame, and all of them as ``video.mp4`` in the output folder.

    A frame that is told again is drawn again. The first frame that a new process of the arm
    is told has no red: what was expected died with the process before.

    Args: every: from one picture to the next, in frames; video: whether a video is made. fps: of the video, frames per
        second.
    Raises ValueError: `every` is below 1, or `fps` is not positive."""

    def __init__(self, every: int = 8, video: bool = False, fps: float = 30.0) -> None:
        if every < 1:
            raise ValueError(f"every is {every}; expected at least 1 frame")
        if not fps > 0.0:
            raise ValueError(f"fps is {fps}; expected a positive number")
        self._every = 1 if video else every
        self._video = video
        self._fps = fps
        self._folder: Path | None = None
        self._frames: set[int] = set()
        self._beliefs: dict[int, AnyArmBelief] = {}
        self._last: _Shown | None = None

    def open(self, output: Path | None) -> None:
        """Make the folder; without an output folder nothing is drawn. Raises DataError: there is a picture or a video
        that would be replaced, and may not be written over."""
        if output is not None and not self.overwrite:
            self._check_none(output)
        self._begin(output)

    def open_again(self, output: Path | None) -> None:
        """Find the pictures that are there, for the contact sheet; a half one is removed."""
        self._begin(output)
        if self._folder is None:
            return
        for path in self._folder.iterdir():
            if path.name.endswith(UNFINISHED):
                path.unlink()
            elif found := _PICTURE.fullmatch(path.name):
                self._frames.add(int(found[1]))

    def record(self, step: Step) -> None:
        """Draw the frame, if it is one to be drawn."""
        if self._folder is None:
            return
        epoch = step.epoch
        expected = self._beliefs.get(epoch - 1)
        kept = {at: belief for at, belief in self._beliefs.items() if epoch - _EPOCHS_AGAIN <= at < epoch}
        self._beliefs = {**kept, epoch: step.belief}
        if not step.observations:
            return
        shown = _Shown(step.sensed["frame"], step.observations[0]["image"], expected, step.sensed)
        due = (epoch - 1) % self._every == 0
        self._last = None if due else shown
        if due:
            self._write(shown)

    def close(self) -> None:
        """Draw the last frame and the contact sheet, and make the video."""
        if self._folder is None:
            return
        if self._last is not None:
            self._write(self._last)
        self._last = None
        if self._frames:
            pictures = [self._path(self._folder, frame) for frame in sorted(self._frames)]
            write_picture(self._folder / CONTACT_SHEET, contact_sheet(pictures))
            if self._video:
                write_video(self._folder.parent / VIDEO_FILE, pictures, self._fps)

    def _begin(self, output: Path | None) -> None:
        self._frames = set()
        self._folder = None if output is None else output / PICTURES_FOLDER
        if self._folder is not None:
            self._folder.mkdir(exist_ok=True)

    def _check_none(self, output: Path) -> None:
        folder = output / PICTURES_FOLDER
        pictures = sorted(path for path in folder.glob("*.png") if _PICTURE.fullmatch(path.name))
        single = (folder / CONTACT_SHEET, *((output / VIDEO_FILE,) if self._video else ()))
        there = [*pictures, *(path for path in single if path.exists())]
        if there:
            raise DataError(f"{there[0]}: is there already; --overwrite replaces it, or name another output folder")

    def _write(self, shown: _Shown) -> None:
        assert self._folder is not None
        path = self._path(self._folder, shown.frame)
        write_picture(path, overlay(shown.image, shown.expected, shown.corrected))
        self._frames.add(shown.frame)

    @staticmethod
    def _path(folder: Path, frame: int) -> Path:
        return folder / f"frame-{frame:06d}.png"


def overlay(image: Array, expected: AnyArmBelief | None, corrected: AnyArmBelief) -> Array:
    """An image, uint8, (h, w) gray or (h, w, 3) RGB, with the edges of an arm's beliefs over it, as predicted before it
    (None for none) and after it, when the camera is known; uint8 RGB (h, w, 3)."""
    picture: Array = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else np.array(image)
    camera, intrinsics = corrected["camera"], corrected["intrinsics"]
    assert camera is not None
    assert intrinsics is not None
    if expected is not None and expected["camera"] is not None:
        moved = invert(camera) @ expected["camera"]
        _draw_lines(picture, edges_seen(expected["objects"], moved, intrinsics), EXPECTED, _EXPECTED_PX)
    tracked = [item for item in corrected["objects"] if item["status"] == "tracked"]
    _draw_lines(picture, edges_seen(tracked, np.eye(4), intrinsics), CORRECTED, _CORRECTED_PX)
    counts = {status: sum(item["status"] == status for item in corrected["objects"]) for status in _STATUSES}
    text = "  ".join(f"{count} {status}" for status, count in counts.items() if count)
    height, width = picture.shape[:2]
    picture[height - _STRIP_PX :] //= 4
    _write_text(picture, f"frame {corrected['frame']}   {text}", (8, height - 8), _WHITE)
    _write_text(picture, "expected", (width - 160, height - 8), EXPECTED)
    _write_text(picture, "corrected", (width - 82, height - 8), CORRECTED)
    return picture


def edges_seen(objects: Sequence[TrackedObject | PaperObject], moved: Floats, intrinsics: Array) -> Floats:
    """The expected edges of objects in the image, (n, 2, 2) pixels; `moved` goes before their poses."""
    lines = [transform(moved @ item["pose"], np.asarray(item["edges"])) for item in objects if len(item["edges"])]
    points = np.concatenate([np.zeros((0, 2, 3)), *lines])
    return project(points[points[..., 2].min(axis=1) > NEAREST_M], intrinsics)


def contact_sheet(pictures: Sequence[Path]) -> Array:
    """Up to nine of the pictures, evenly chosen, the first and the last among them, smaller and in full rows."""
    columns = min(_SHEET_COLUMNS, len(pictures))
    count = min(_SHEET_PICTURES, len(pictures) - len(pictures) % columns)
    chosen = [pictures[round(at)] for at in np.linspace(0, len(pictures) - 1, count)]
    tiles = []
    for path in chosen:
        picture = read_image(path)
        height = round(picture.shape[0] * _SHEET_WIDTH_PX / picture.shape[1])
        tiles.append(cv2.resize(picture, (_SHEET_WIDTH_PX, height), interpolation=cv2.INTER_AREA))
    rows = [np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)]
    return np.vstack(rows)


def write_video(path: Path, pictures: Sequence[Path], fps: float) -> None:
    """Put pictures of one size together as an MP4 video. Raises DataError: it cannot be written."""
    height, width = read_image(pictures[0]).shape[:2]
    unfinished = path.with_name(f"unfinished-{path.name}")
    writer = cv2.VideoWriter(str(unfinished), cv2.VideoWriter.fourcc(*"mp4v"), fps, (width, height))
    try:
        if not writer.isOpened():
            raise DataError(f"{path}: cannot be written; OpenCV finds no MP4 encoder, or no such folder")
        for picture in pictures:
            writer.write(np.ascontiguousarray(read_image(picture)[..., ::-1]))
    finally:
        writer.release()
    os.replace(unfinished, path)


def _draw_lines(picture: Array, lines: Floats, colour: tuple[int, int, int], width_px: int) -> None:
    pixels = np.rint(np.clip(lines, -4096, 8192) * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(picture, list(pixels), False, colour, width_px, cv2.LINE_AA, _SHIFT)


def _write_text(picture: Array, text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
