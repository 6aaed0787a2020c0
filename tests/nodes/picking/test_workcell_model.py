"""The arm's model for physics."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pybullet_data
import pytest

from hierax.nodes.picking.workcell import FINGER_BOXES_M, FINGER_SIDES, panda_file, panda_text
from hierax.nodes.sources.files import DataError


def test_only_what_collides_is_left() -> None:
    robot = ElementTree.fromstring(panda_text())
    original = ElementTree.parse(panda_file()).getroot()
    assert not list(robot.iter("visual"))
    assert len(list(robot.iter("joint"))) == len(list(original.iter("joint")))
    meshes = [Path(mesh.get("filename", "")) for mesh in robot.iter("mesh")]
    assert len(meshes) == 9
    assert all(mesh.is_absolute() and mesh.is_file() for mesh in meshes)


def test_the_fingers_boxes_hold_the_finger() -> None:
    path = panda_file().parent / "meshes" / "collision" / "finger.obj"
    lines = [line.split()[1:4] for line in path.read_text().splitlines() if line.startswith("v ")]
    corners = np.array(lines, dtype=np.float64)
    boxes = np.array(FINGER_BOXES_M)
    np.testing.assert_allclose(boxes[:, 0].min(axis=0), corners.min(axis=0), atol=5e-4)
    np.testing.assert_allclose(boxes[:, 1].max(axis=0), corners.max(axis=0), atol=5e-4)


def test_both_fingers_have_boxes_on_their_side() -> None:
    robot = ElementTree.fromstring(panda_text())
    for link in robot.iter("link"):
        side = FINGER_SIDES.get(link.get("name", ""))
        if side is None:
            continue
        middles = [origin.get("xyz", "").split() for origin in link.findall("collision/origin")]
        assert len(middles) == len(FINGER_BOXES_M)
        assert all(float(middle[1]) * side > 0.0 for middle in middles)


def test_a_missing_model_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pybullet_data, "getDataPath", lambda: str(tmp_path))
    with pytest.raises(DataError, match=r"panda\.urdf: cannot be read"):
        panda_text()
