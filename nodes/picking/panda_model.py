"""The Panda of pybullet_data as physics needs it: without what is only to be seen, with boxes for fingers.

The model's finger is a mesh with a rounded inside. In its first step against a box it has one point of contact, against
which the box turns; a box in its place has four. That matters where the simulator is built anew in every epoch
(docs/decisions/0017), and leaving out the visible meshes makes that five times as fast.
"""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pybullet_data

from hierax.nodes.tracking.errors import DataError

_FOLDER = "franka_panda"
_FILE = "panda.urdf"
_PACKAGE = "package://"

# By the name of its link, on which side of the middle a finger is, along the gripper's y.
FINGERS = {"panda_leftfinger": 1.0, "panda_rightfinger": -1.0}

# The pad and the rest of a finger in its link's frame, lowest and highest corners, measured from the mesh.
FINGER_BOXES_M = (
    ((-0.00875, 0.0, 0.036), (0.00875, 0.0145, 0.0538)),
    ((-0.01045, 0.0075, 0.0), (0.01045, 0.0264, 0.036)),
)


def panda_file() -> Path:
    """The model as it comes with pybullet_data, to be looked at."""
    return Path(pybullet_data.getDataPath()) / _FOLDER / _FILE


def panda_text() -> bytes:
    """The model for physics, URDF; its meshes are named by absolute paths. Raises DataError: pybullet_data's model is
    missing or damaged."""
    path = panda_file()
    try:
        robot = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        side = FINGERS.get(link.get("name", ""))
        if side is not None:
            _with_boxes(link, side)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").replace(_PACKAGE, f"{path.parent}{os.sep}"))
    return ElementTree.tostring(robot)


def _with_boxes(link: ElementTree.Element, side: float) -> None:
    """Put the boxes of a finger in the place of its mesh."""
    for collision in link.findall("collision"):
        link.remove(collision)
    for low, high in np.array(FINGER_BOXES_M):
        box = ((low + high) / 2 * (1, side, 1), high - low)
        middle, size = (" ".join(f"{number:.9f}" for number in each) for each in box)
        collision = ElementTree.SubElement(link, "collision")
        ElementTree.SubElement(collision, "origin", rpy="0 0 0", xyz=middle)
        ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), "box", size=size)
