"""A moving picture of a recorded run of the tower deployment: what is seen from beside and by the camera, and why.

    hierax run tower --set person=knock --record tower.mcap
    python benchmarks/tower_film.py tower.mcap tower.webp               # one epoch of ten
    python benchmarks/tower_film.py tower.mcap sheet.jpg --every 120    # all on one sheet

Everything in it is what the nodes show to a viewer (`hierax view`). The recording needs the world's pictures.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from commands import at_least
from numpy.typing import NDArray

from hierax.nodes.tracking.evaluation.pictures import CORRECTED
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import allowance_of
from hierax.runtime.viewing.presenter import Canvas, ViewPresenter
from hierax.runtime.viewing.recorded_run import show_recording
from hierax.runtime.viewing.views import shown_by

SIZE = (320, 240)  # of either picture, pixels
STRIP_PX, LINE_PX = 44, 18
SHOWN_MS = 100  # each picture
QUALITY = 45
COLUMNS = 2

Picture = NDArray[np.uint8]


class Film(ViewPresenter):
    """Draws one epoch of so many."""

    def __init__(self, every: int) -> None:
        super().__init__(Canvas())
        self.frames: list[Picture] = []
        self._every = every
        self._things: dict[str, Any] = {}
        self._epoch = 0

    def step(self, name: str, node: Node, step: Step, start: Any = None) -> None:
        if step.epoch % self._every and step.epoch != 1:
            return
        if step.epoch != self._epoch:
            self._draw()
            self._epoch = step.epoch
        self._things |= {each.path: each.thing for each in shown_by(name, node, step, None)}

    def close(self) -> None:
        self._draw()

    def _draw(self) -> None:
        things, self._things = self._things, {}
        if not things:
            return
        if "camera/arm/image" not in things:
            raise SystemExit("the recording has no pictures of the world's; make one without --exclude")
        beside = cv2.resize(things["beside/world/picture"].pixels, SIZE, interpolation=cv2.INTER_AREA)
        strip = np.full((STRIP_PX, 2 * SIZE[0], 3), 24, np.uint8)
        why, skill = (_lines(things[path]) for path in ("builder/why", "skills/skill"))
        held = next((line for line in why if line.startswith("plan")), "")
        rule = " > ".join(why[0].split(" > ")[-2:])
        for row, text in enumerate((f"{self._epoch}: {rule}  {held}", "; ".join(skill[:2]))):
            at = (8, 17 + row * LINE_PX)
            cv2.putText(strip, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
        self.frames.append(np.asarray(np.vstack((np.hstack((beside, _camera(things))), strip)), np.uint8))


def _camera(things: dict[str, Any]) -> Picture:
    """The camera's picture with the edges of what is tracked."""
    picture = things["camera/arm/image"].pixels.copy()
    lines = np.round(16 * np.asarray(things["camera/arm/corrected"].lines)).astype(np.int32)
    cv2.polylines(picture, list(lines), False, CORRECTED, 2, cv2.LINE_AA, 4)
    return np.asarray(cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA), np.uint8)


def _lines(text: str) -> list[str]:
    return [line for line in text.replace("**", "").splitlines() if line]


def main() -> int:
    """Read the recording, write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("picture", type=Path, help="a .webp that moves; a .jpg or .png with all on one sheet")
    parser.add_argument("--every", type=at_least(1), default=10, help="one epoch of so many")
    options = parser.parse_args()
    try:
        recording = Recording.open(options.recording)
    except HieraxError as error:
        raise SystemExit(f"{options.recording}: {error}") from error
    film = Film(options.every)
    show_recording(recording, film, allowance_of(recording))
    if not film.frames:
        raise SystemExit(f"{options.recording}: there is no epoch with pictures in it")
    frames = [frame[..., ::-1].copy() for frame in film.frames]
    if not _is_written(options.picture, frames):
        raise SystemExit(f"{options.picture}: cannot be written; expected a .webp, a .jpg or a .png in a folder")
    print(f"{options.picture}: {len(film.frames)} pictures, {options.picture.stat().st_size // 1000} kB")
    return 0


def _is_written(picture: Path, frames: list[Picture]) -> bool:
    """Write the frames, BGR, as a picture that moves, or on one sheet; whether that could be done."""
    if picture.suffix == ".webp":
        animation = cv2.Animation()
        animation.frames, animation.durations = frames, np.full(len(frames), SHOWN_MS)
        return bool(cv2.imwriteanimation(str(picture), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY]))
    if picture.suffix not in (".jpg", ".png"):
        return False
    frames = [*frames, *[np.full_like(frames[0], 255)] * (-len(frames) % COLUMNS)]
    rows = [np.hstack(frames[at : at + COLUMNS]) for at in range(0, len(frames), COLUMNS)]
    quality = [cv2.IMWRITE_JPEG_QUALITY, 80] if picture.suffix == ".jpg" else []
    return bool(cv2.imwrite(str(picture), np.vstack(rows), quality))


if __name__ == "__main__":
    sys.exit(main())
