"""The tracking deployment in the web viewer, as a browser draws it: what a user sees."""

from __future__ import annotations

import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from support import chromium
from support.launched import Command

from hierax.nodes.tracking.evaluation.pictures import CORRECTED, EXPECTED
from hierax.runtime.core.showing import PALETTE

pytest.importorskip("rerun", reason="the extra [view] is not installed")
pytestmark = pytest.mark.skipif(chromium.PROGRAM is None, reason="chromium is not installed")

SIZE = (1200, 750)
TIMEOUT_S = 120.0
BODIES = 6

Picture = NDArray[np.uint8]

# left, top, right, bottom in pixels, within the views of deploy/tracking.yaml's layout
CAMERA = (20, 70, 430, 370)
SCENE = (470, 70, 890, 370)
IMAGINED = (20, 410, 430, 710)
HIERARCHY = (470, 410, 890, 710)
CURVES = {"error_mm": (975, 70, 1190, 240), "turn_deg": (975, 300, 1190, 470)}


def part(picture: Picture, box: tuple[int, int, int, int]) -> Picture:
    left, top, right, bottom = box
    return picture[top:bottom, left:right]


def pixels_like(picture: Picture, colour: tuple[int, ...], within: int = 40) -> int:
    """How many pixels are about of a colour."""
    return int((np.abs(picture.astype(int) - np.array(colour)).max(axis=2) <= within).sum())


def hues(picture: Picture, least: int = 10) -> int:
    """How many of the bodies' colours are there, in whatever light."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
    strong = hsv[(hsv[..., 1] > 90) & (hsv[..., 2] > 50)][:, 0].astype(int)
    palette = cv2.cvtColor(np.array([PALETTE[:BODIES]], np.uint8), cv2.COLOR_RGB2HSV)[0, :, 0].astype(int)
    apart = np.abs(strong[:, None] - palette)
    return int(((np.minimum(apart, 180 - apart) <= 5).sum(axis=0) >= least).sum())


def drawn(picture: Picture) -> int:
    """How many pixels are unlike the ground; what colour text has depends on the viewer's version."""
    ground = np.median(picture.reshape(-1, 3), axis=0)
    return picture.shape[0] * picture.shape[1] - pixels_like(picture, tuple(ground), 60)


def lacking(picture: Picture) -> list[str]:
    """What is not to be seen of that which should."""
    camera, scene = part(picture, CAMERA), part(picture, SCENE)
    found = {
        "the camera's image": float(camera.std()) > 25.0 and hues(camera, 200) >= 5,
        "expected edges in red": pixels_like(camera, EXPECTED) > 100,
        "matched edges in green": pixels_like(camera, CORRECTED) > 100,
        "bodies in the scene": hues(scene, 40) >= 5,
        "depth with labels": hues(part(picture, IMAGINED), 200) >= 4,
        "the hierarchy": 500 < drawn(part(picture, HIERARCHY)) < 20_000,
        **{f"curves of {name}": hues(part(picture, box)) >= 4 for name, box in CURVES.items()},
    }
    return [what for what, is_there in found.items() if not is_there]


def decoded(png: bytes) -> Picture:
    picture: Any = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(picture[..., ::-1], np.uint8)


def test_a_blank_page_lacks_everything() -> None:
    assert len(lacking(np.full((SIZE[1], SIZE[0], 3), 255, np.uint8))) == 8
    assert len(lacking(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))) == 8


def test_tracking_is_seen_in_a_browser(tmp_path: Path) -> None:
    with Command(tmp_path, "view", "tracking", "--epochs", "8") as view, chromium.browser(SIZE) as page:
        view.until_said("Ctrl-C ends the viewer")
        address = re.search(r"seen at (http://127\.0\.0\.1:\S+)", view.err)
        assert address is not None, view.err
        page.go(address[1])
        patience = time.monotonic() + TIMEOUT_S
        missing = ["all"]
        while missing and time.monotonic() < patience:
            png = page.picture()
            missing = lacking(decoded(png))
        (tmp_path / "view.png").write_bytes(png)
        assert not missing, f"see {tmp_path / 'view.png'}: there is no sign of {missing}"
        os.kill(view.process.pid, signal.SIGINT)
        view.end()
        assert view.process.returncode == 0, view.err
