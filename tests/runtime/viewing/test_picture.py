"""The tracking deployment in the web viewer, as a browser draws it: what a user sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import chromium
from support.pixels import Picture, drawn, part, pixels_like
from support.pixels import hues as hues_of
from support.viewed import check_seen

from hierax.nodes.tracking.evaluation.pictures import CORRECTED, EXPECTED

pytest.importorskip("rerun", reason="the extra [view] is not installed")
pytestmark = pytest.mark.skipif(chromium.PROGRAM is None, reason="chromium is not installed")

SIZE = (1200, 750)
BODIES = 6

# left, top, right, bottom in pixels, within the views of deploy/tracking.yaml's layout
CAMERA = (20, 70, 430, 370)
SCENE = (470, 70, 890, 370)
IMAGINED = (20, 410, 430, 710)
HIERARCHY = (470, 410, 890, 710)
CURVES = {"error_mm": (975, 70, 1190, 240), "turn_deg": (975, 300, 1190, 470)}


def hues(picture: Picture, least: int = 10) -> int:
    return hues_of(picture, BODIES, least)


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


def test_a_blank_page_lacks_everything() -> None:
    assert len(lacking(np.full((SIZE[1], SIZE[0], 3), 255, np.uint8))) == 8
    assert len(lacking(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))) == 8


def test_tracking_is_seen_in_a_browser(tmp_path: Path) -> None:
    check_seen(tmp_path, SIZE, lacking, "Ctrl-C ends the viewer", "tracking", "--epochs", "8")
