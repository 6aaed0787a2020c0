"""Pictures from beside the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.picking.views import SceneView, Views
from hierax.nodes.picking.world import PickWorld
from hierax.nodes.sources.images import read_image
from hierax.runtime import Step

SIZE = (160, 120)


def step(frame: int) -> Step:
    belief = {**PickWorld(0).initial_belief(), "frame": frame}
    return Step(frame + 1, 1, 0.0, (), belief, (), (), "default", (), belief)


def test_arm_and_cubes_are_in_the_picture() -> None:
    belief = PickWorld(1).initial_belief()
    picture = SceneView().beside(belief, SIZE)
    assert picture.shape == (120, 160, 3)
    red, green, blue = picture.reshape(-1, 3).astype(int).T
    assert np.sum((red > 2 * green) & (red > 2 * blue)) > 3
    assert np.sum((blue > 1.5 * green) & (blue > 2 * red)) > 3
    grey = np.ptp(np.stack((red, green, blue)), axis=0) < 6
    assert np.sum(grey & (red < 230)) > 200


def test_every_so_many_frames_are_drawn_and_a_sheet_of_them(tmp_path: Path) -> None:
    probe = Views(every=2, width=SIZE[0], height=SIZE[1])
    probe.open(tmp_path)
    for frame in range(4):
        probe.record(step(frame))
    probe.close()
    names = sorted(path.name for path in (tmp_path / "views").iterdir())
    assert names == ["contact-sheet.png", "frame-000000.png", "frame-000002.png"]
    assert read_image(tmp_path / "views" / names[1]).shape == (120, 160, 3)


def test_without_an_output_folder_nothing_is_drawn() -> None:
    probe = Views()
    probe.open(None)
    probe.record(step(0))
    probe.close()


def test_a_step_of_no_frames_is_refused() -> None:
    with pytest.raises(ValueError, match="every is 0"):
        Views(every=0)
