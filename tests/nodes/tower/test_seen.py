"""A recorded tower in the web viewer, as a browser draws it: all that belongs together is beside one another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import chromium
from support.launched import hierax
from support.pixels import Picture, drawn, part, pixels_like
from support.viewed import check_seen

from hierax.nodes.tracking.evaluation.pictures import CORRECTED

pytest.importorskip("rerun", reason="the extra [view] is not installed")
pytestmark = pytest.mark.skipif(chromium.PROGRAM is None, reason="chromium is not installed")

SIZE = (1600, 1000)

# left, top, right, bottom in pixels, within the views of deploy/tower.yaml's layout
BESIDE, CAMERA = (20, 70, 590, 490), (20, 560, 590, 960)
SCENE, TOWERS = (610, 70, 1190, 490), (610, 560, 1190, 960)
WHY, SKILL = (1210, 70, 1580, 260), (1210, 300, 1580, 480)
RED, BLUE = (214, 62, 54), (52, 110, 214)  # of the first two cubes in the graph
TABLE = (168, 134, 98)  # from beside


def lacking(picture: Picture) -> list[str]:
    """What is not to be seen of that which should."""
    beside, camera, graph = part(picture, BESIDE), part(picture, CAMERA), part(picture, TOWERS)
    found = {
        "arm and table from beside": pixels_like(beside, TABLE) > 5000 and float(beside.std()) > 25.0,
        "matched edges in the camera's image": float(camera.std()) > 15.0 and pixels_like(camera, CORRECTED) > 50,
        "the scene": drawn(part(picture, SCENE)) > 500,
        "both cubes in the graph": pixels_like(graph, RED) > 10 and pixels_like(graph, BLUE) > 10,
        "the rule": drawn(part(picture, WHY)) > 300,
        "the skill": drawn(part(picture, SKILL)) > 200,
    }
    return [what for what, is_there in found.items() if not is_there]


def test_a_blank_page_lacks_everything() -> None:
    assert len(lacking(np.full((SIZE[1], SIZE[0], 3), 255, np.uint8))) == 6


def test_a_recorded_tower_is_seen_in_a_browser(tmp_path: Path) -> None:
    file = str(tmp_path / "run.mcap")
    hierax("run", "tower", "--set", "cubes=2", "--set", "tower=[1, 2]", "--epochs", "20", "--record", file)
    check_seen(tmp_path, SIZE, lacking, "Ctrl-C ends the viewer", file, "--from", "12")
