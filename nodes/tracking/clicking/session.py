"""What a user has clicked so far: one object after the other, corner by corner, until each is accepted or left out."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.clicking.model_view import LEAST, Marked, ModelView, View, corners_of, fitted, judged
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.math.geometry import Array, Floats
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.model.symmetry import model_of
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.schema import TRACKED, FirstBody, FirstPose, Picture
from hierax.nodes.tracking.spatial import SpatialNode

_MOVED_PX = 3.0  # how much farther from the clicks than by them alone an aligned pose may put the corners

_IMAGES = 4  # so often is the picture seen, the first time to know the camera


class Session:
    """Asks for the corners of a scene's objects, by the numbers of their models, in its first picture. Nothing here
    waits or writes. Raises DataError: the picture or a model is missing or damaged."""

    def __init__(self, scene: BopScene, objects: list[int]) -> None:
        frame = scene.frames[0]
        self.image: Array = scene.image(frame.image)
        lens, number = frame.intrinsics, frame.im_id
        self._picture: Picture = {"image": self.image, "camera": np.eye(4), "intrinsics": lens, "frame": number}
        self._objects = objects
        meshes = {obj_id: scene.model(obj_id) for obj_id in objects}
        self._models = {obj_id: model_of(*meshes[obj_id]) for obj_id in meshes}
        self._views = {obj_id: ModelView(shape_of(*mesh)) for obj_id, (mesh, _) in meshes.items()}
        self._bodies: list[FirstBody] = []
        self._dashes: list[list[float]] = []  # of what is accepted
        self._at = 0
        self._begin()

    @property
    def done(self) -> bool:
        """Whether every object is accepted or left out."""
        return self._at == len(self._objects)

    @property
    def found(self) -> list[tuple[int, Floats]]:
        """The objects that were accepted: model's number and camera_from_object."""
        return [(each["obj_id"], each["pose"]) for each in self._bodies if each["pose"] is not None]

    def do(self, asked: dict[str, Any]) -> None:
        """What the user asks for: ``{"action": "click", "x": 12.5, "y": 40}``, ``hidden``, ``undo``, ``redo``,
        ``accept`` or ``leave``, or ``turn`` with ``turn`` and ``tilt`` in degrees. What cannot be
        done is told in the notice."""
        actions: dict[str, Callable[[], None]] = {
            "hidden": lambda: self._answer(None),
            "undo": self._undo,
            "redo": self._begin,
            "accept": self._accept,
            "leave": self._leave,
            "click": lambda: self._click(asked.get("x"), asked.get("y")),
            "turn": lambda: self._turn(asked.get("turn"), asked.get("tilt")),
        }
        action = actions.get(str(asked.get("action")))
        if self.done or action is None:
            self._notice = "That is all." if self.done else "No such thing can be done here."
            return
        self._notice = ""
        action()

    def state(self) -> dict[str, Any]:
        """All that the page shows, as JSON has it."""
        if self.done:
            return {"done": True, "found": len(self._bodies), "accepted": self._dashes}
        clicked = self._clicked()
        return {
            "done": False,
            "object": f"{self._at + 1} of {len(self._objects)}: model {self._objects[self._at]}",
            "corner": None if self._asked is None else len(self._answers) + 1,
            "clicked": [[number, *pixel.tolist()] for number, _, pixel in clicked],
            "dashes": self._own,
            "accepted": self._dashes,
            "fits": self._pose is not None,
            "turn": self._view[0],
            "tilt": self._view[1],
            "notice": self._notice or self._advice(len(clicked)),
        }

    def model_picture(self) -> Array:
        """RGB: the model with the corner that is asked for."""
        asked = None if self._asked is None else (len(self._answers) + 1, self._asked)
        given: list[Marked] = [(number, corner) for number, corner, _ in self._clicked()]
        return self._model.picture(self._view, given, asked)

    def _begin(self) -> None:
        """The object from its first corner on."""
        self._notice, self._judgement = "", ""
        self._answers: list[Floats | None] = []
        self._pose: Floats | None = None
        self._own: list[list[float]] = []
        self._view: View = (0.0, 0.0)
        if not self.done:
            self._model = self._views[self._objects[self._at]]
            self._corners = corners_of(self._model.shape)
            self._view = self._model.showing(self._model.shape.high if self._asked is None else self._asked, None)

    @property
    def _asked(self) -> Floats | None:
        """The corner that is asked for; None where there is no further one."""
        return self._corners[len(self._answers)] if len(self._answers) < len(self._corners) else None

    def _clicked(self) -> list[tuple[int, Floats, Floats]]:
        """Number, corner and pixel of each that was clicked."""
        return [
            (number, corner, pixel)
            for number, (corner, pixel) in enumerate(zip(self._corners, self._answers, strict=False), start=1)
            if pixel is not None
        ]

    def _click(self, x: Any, y: Any) -> None:
        height, width = self.image.shape[:2]
        if not all(type(part) in (int, float) for part in (x, y)) or not (
            -0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5
        ):
            self._notice = "That is outside of the picture."
        else:
            self._answer(np.array([x, y], dtype=np.float64))

    def _turn(self, turn: Any, tilt: Any) -> None:
        if all(type(part) in (int, float) and abs(part) < 1e6 for part in (turn, tilt)):
            self._view = (float(turn) % 360.0, float(np.clip(tilt, -89.0, 89.0)))

    def _answer(self, pixel: Floats | None) -> None:
        if self._asked is None:
            self._notice = "There is no further corner."
            return
        self._answers.append(pixel)
        self._fit()

    def _undo(self) -> None:
        self._answers = self._answers[:-1]
        self._fit()

    def _leave(self) -> None:
        self._at += 1
        self._begin()

    def _accept(self) -> None:
        if self._pose is None:
            self._notice = "There is no pose yet that fits."
            return
        self._bodies.append(self._body(self._pose))
        self._dashes += self._own
        self._leave()

    def _body(self, pose: Floats) -> FirstBody:
        obj_id = self._objects[self._at]
        return {"id": len(self._bodies) + 1, "obj_id": obj_id, "pose": pose, "model": self._models[obj_id]}

    def _fit(self) -> None:
        """The pose by what is clicked, where that is enough; and as the image has it."""
        self._pose, self._own, self._judgement = None, [], ""
        if self._asked is not None:
            self._view = self._model.showing(self._asked, self._view)
        clicked = self._clicked()
        if len(clicked) < LEAST:
            return
        corners, pixels = (np.array([each[part] for each in clicked]) for part in (1, 2))
        fit = fitted(corners, pixels, self._picture["intrinsics"])
        if fit is None or not fit.fits:
            off = "No pose fits"
            if fit is not None:
                off = f"The corners lie {fit.off_px:.1f} pixels beside those of the model"
                off += f", number {clicked[fit.worst][0]} most"
            self._judgement = f"{off}. Take back what was not meant, or begin again."
            return
        image = aligned(self._picture, [*self._bodies, self._body(fit.pose)])
        there = None if image is None else judged(image, corners, pixels, self._picture["intrinsics"])
        agreed = there is not None and there.off_px < fit.off_px + _MOVED_PX
        self._pose = there.pose if there is not None and agreed else fit.pose
        self._judgement = (
            f"Clicks fit by {fit.off_px:.1f} pixels, "
            + ("and the image's edges were followed." if agreed else "but the image does not confirm it.")
            + " Accept it if the green edges lie on the object, or click further corners."
        )
        height, width = self.image.shape[:2]
        dashes = self._model.edges(self._pose, self._picture["intrinsics"], (width, height))
        self._own = np.round(dashes, 2).tolist()

    def _advice(self, clicked: int) -> str:
        if self._judgement:
            return self._judgement
        if len(self._corners) < LEAST:
            return f"This model has no {LEAST} corners that could be clicked: leave it out."
        if self._asked is None:
            return f"{clicked} corners are clicked, and at least {LEAST} are needed: begin again, or leave it out."
        return f"Click where the corner is that is red in the model; {LEAST - clicked} more, at least."


def aligned(picture: Picture, bodies: Sequence[FirstBody]) -> Floats | None:
    """camera_from_object of the last of some bodies where the image has it; None where the image does not support it.
    Their ``pose`` is camera_from_object, as the camera's frame is the world's here; those before the last one are seen,
    too, and may hide it."""
    first: list[FirstPose] = [{"id": each["id"], "obj_id": each["obj_id"], "pose": each["pose"]} for each in bodies]
    arm, spatial, imagine = ArmNode(first), SpatialNode(bodies), SegmentedDepth()
    sensed, believed = arm.initial_belief(), spatial.initial_belief()
    for _ in range(_IMAGES):
        sensed = arm.observe((picture,), sensed)
        believed = spatial.predict((), (), spatial.observe(poses_seen(sensed), believed))
        last = sensed["objects"][-1]
        sensed = arm.predict(imagine(believed), (), sensed)
    return last["pose"] if last["status"] == TRACKED else None
