"""Pictures of the whole scene, arm included, from beside the table: for people, not for any node."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hierax.nodes.picking.panda import JOINTS
from hierax.nodes.picking.workcell import FINGERS, panda_file
from hierax.nodes.sources.images import write_picture
from hierax.nodes.tracking.evaluation.pictures import CONTACT_SHEET, contact_sheet
from hierax.nodes.tracking.imagery.physics import Bullet, place_of
from hierax.nodes.tracking.math.geometry import Array, Size
from hierax.runtime import Probe, Step, Value

VIEWS_FOLDER = "views"

BESIDE = ((1.20, -0.85, 0.62), (0.35, 0.0, 0.27))  # where the view is from, and what it looks at, metres
_TABLE_HALF_M = (0.75, 0.65, 0.02)
_TABLE_COLOUR = (168, 134, 98)
_FIELD_DEG = 42.0
_RANGE_M = (0.1, 4.0)


class SceneView:
    """Draws arm, table and cubes by pybullet's TinyRenderer, with the arm's visible meshes."""

    def __init__(self) -> None:
        self._bullet = Bullet()
        self.arm = int(self._bullet.loadURDF(str(panda_file()), useFixedBase=1))  # its name in the labels of `draw`
        self._box(_TABLE_HALF_M, _TABLE_COLOUR, (0.0, 0.0, -_TABLE_HALF_M[2]))
        self._cubes: dict[int, int] = {}
        self._obstacles: list[int] = []

    def draw(self, belief: Value, view: Sequence[float], lens: Sequence[float], size: Size) -> tuple[Array, Array]:
        """The scene of a world's belief, by OpenGL's view and projection matrices (16,), by columns: uint8 RGB (h, w,
        3), and int32 (h, w), whose body is seen, -1 for none."""
        bullet = self._bullet
        for joint, place in zip((*range(JOINTS), *FINGERS), (*belief["joints"], *belief["fingers"]), strict=True):
            bullet.resetJointState(self.arm, joint, place)
        for body in belief["bodies"]:
            if body["id"] not in self._cubes:
                self._cubes[body["id"]] = self._box([body["side_m"] / 2] * 3, body["colour"], (0.0, 0.0, 0.0))
            bullet.resetBasePositionAndOrientation(self._cubes[body["id"]], *place_of(body["pose"]))
        for obstacle in self._obstacles:
            bullet.removeBody(obstacle)
        self._obstacles = [
            self._box([side / 2 for side in each["size"]], each["colour"], *place_of(each["pose"]))
            for each in belief.get("obstacles", ())
        ]
        width, height = size
        way = {"lightDirection": [-0.42, -0.38, 1.05], "renderer": bullet.ER_TINY_RENDERER}
        drawn = bullet.getCameraImage(width, height, viewMatrix=view, projectionMatrix=lens, **way)
        picture = np.asarray(drawn[2], dtype=np.uint8).reshape(height, width, 4)[..., :3]
        return picture, np.asarray(drawn[4], dtype=np.int32).reshape(height, width)

    def beside(self, belief: Value, size: Size) -> Array:
        """The scene from beside the table, uint8 RGB (h, w, 3)."""
        view = self._bullet.computeViewMatrix(*BESIDE, (0.0, 0.0, 1.0))
        lens = self._bullet.computeProjectionMatrixFOV(_FIELD_DEG, size[0] / size[1], *_RANGE_M)
        return self.draw(belief, view, lens, size)[0]

    def _box(
        self,
        half: Sequence[float],
        colour: Sequence[int],
        place: Sequence[float],
        turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
    ) -> int:
        rgba = [part / 255.0 for part in colour] + [1.0]
        shape = self._bullet.createVisualShape(self._bullet.GEOM_BOX, halfExtents=half, rgbaColor=rgba)
        return int(self._bullet.createMultiBody(0, -1, shape, basePosition=place, baseOrientation=turn))


class Views(Probe):
    """Draws the world from beside the table, one frame of so many, into ``views/`` in the output folder, with a
    contact sheet at the end. Raises ValueError: `every` is below 1."""

    def __init__(self, every: int = 16, width: int = 480, height: int = 360) -> None:
        if every < 1:
            raise ValueError(f"every is {every}; expected at least 1 frame")
        self._every = every
        self._size = (width, height)
        self._folder: Path | None = None
        self._scene: SceneView | None = None

    def open(self, output: Path | None) -> None:
        """Make the folder; without an output folder nothing is drawn."""
        self._folder = None if output is None else output / VIEWS_FOLDER
        if self._folder is not None:
            self._folder.mkdir(exist_ok=True)

    def record(self, step: Step) -> None:
        """Draw the frame, if it is one to be drawn."""
        if self._folder is None or step.sensed["frame"] % self._every:
            return
        self._scene = self._scene or SceneView()
        picture = self._scene.beside(step.sensed, self._size)
        write_picture(self._folder / f"frame-{step.sensed['frame']:06d}.png", picture)

    def close(self) -> None:
        """Draw the contact sheet."""
        self._scene = None
        if self._folder is None:
            return
        pictures = sorted(self._folder.glob("frame-*.png"))
        if pictures:
            write_picture(self._folder / CONTACT_SHEET, contact_sheet(pictures))
