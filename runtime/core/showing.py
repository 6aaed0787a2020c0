"""Things that a node can show: plain values that say what is seen, and nothing of how it is drawn.

`Node.show` gives them by path. The path's first part names the view that a thing is seen in: ``score/cube`` is in the
node's own view ``score``, ``/scene/cube`` in the view ``scene``, which all nodes share. A view holds things of one
kind:

- a picture: `Image`, `Depth`, `Labels`, `Points2D`, `Lines2D`. In pixels, x to the right, y down,
  the centre of the first pixel at (0, 0).
- a scene: `Mesh`, `Box`, `Points3D`, `Lines3D`, `Axes`, `Camera`. In metres, right-handed;
  poses are (4, 4), from the thing's frame to the scene's.
- a plot: numbers, or `Curve`; each path has one curve.
- a text: `str`, as Markdown.
- a graph: `Graph`.

Arrays may be lists, too. What is built wrongly is refused with a ValueError that says what was expected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Colour = tuple[int, ...]
"""Red, green, blue and perhaps opacity, each 0 to 255."""

Array = NDArray[Any]

WHITE: Colour = (255, 255, 255)
GREY: Colour = (128, 128, 128)

PALETTE: tuple[Colour, ...] = (
    (214, 62, 54),
    (52, 110, 214),
    (62, 164, 82),
    (240, 190, 40),
    (138, 84, 186),
    (236, 126, 44),
    (44, 170, 180),
    (214, 84, 150),
    (150, 110, 70),
    (124, 140, 30),
)


def colour_of(number: int) -> Colour:
    """A colour for what is numbered, the same one wherever it is shown; they repeat after ten."""
    return PALETTE[(number - 1) % len(PALETTE)]


class _Thing:
    """What all things have in common: fields are checked, and set as arrays."""

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _array(self, name: str, *shape: int | None, dtype: type = np.float64) -> Array:
        """Make a field an array of a shape, in which None is any length."""
        given = np.asarray(getattr(self, name))
        if not given.size and shape[0] is None:  # none of them, in whatever way that is written
            given = np.zeros([length or 0 for length in shape], dtype)
        wanted, kinds = ("numbers", "biuf") if dtype is np.float64 else ("whole numbers", "biu")
        fits = len(shape) == given.ndim and all(
            length in (None, own) for length, own in zip(shape, given.shape, strict=True)
        )
        if not fits or given.dtype.kind not in kinds:
            lengths = " × ".join("nk"[at] if length is None else str(length) for at, length in enumerate(shape))
            raise ValueError(
                f"{type(self).__name__}: {name}: expected {lengths} {wanted}, got {given.dtype} of shape {given.shape}"
            )
        array: Array = given.astype(dtype)
        self._set(name, array)
        return array

    def _pose(self, name: str = "pose") -> None:
        if getattr(self, name) is None:
            self._set(name, np.eye(4))
        self._array(name, 4, 4)

    def _colour(self, name: str = "colour") -> None:
        self._set(name, _colour(getattr(self, name), f"{type(self).__name__}: {name}"))


@dataclass(frozen=True, eq=False)
class Image(_Thing):
    """A picture's ground.

    Attributes:
        pixels: (h, w) grey or (h, w, 3) RGB, uint8.
    """

    pixels: ArrayLike

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels)
        if pixels.dtype != np.uint8 or not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)):
            raise ValueError(
                f"Image: pixels: expected h × w or h × w × 3 of uint8, got {pixels.dtype} of shape {pixels.shape}"
            )
        self._set("pixels", pixels)


@dataclass(frozen=True, eq=False)
class Depth(_Thing):
    """A picture that says how far away each pixel is.

    Attributes:
        metres: (h, w); 0 where nothing is.
    """

    metres: ArrayLike

    def __post_init__(self) -> None:
        self._array("metres", None, None)


@dataclass(frozen=True, eq=False)
class Labels(_Thing):
    """A picture that says what each pixel belongs to.

    Attributes:
        labels: (h, w), 0 to 255; 0 is nothing.
        names: by label.
        colours: by label; else `colour_of` it.
        opacity: 0 to 1, over what else is in the picture.
    """

    labels: ArrayLike
    names: Mapping[int, str] | None = None
    colours: Mapping[int, Colour] | None = None
    opacity: float = 0.6

    def __post_init__(self) -> None:
        labels = self._array("labels", None, None, dtype=np.int64)
        if labels.size and not 0 <= labels.min() <= labels.max() <= 255:
            raise ValueError(f"Labels: labels: expected 0 to 255, got {labels.min()} to {labels.max()}")
        self._set("labels", labels.astype(np.uint8))
        self._set("names", dict(self.names or {}))
        colours = {key: _colour(colour, f"Labels: colours: {key}") for key, colour in (self.colours or {}).items()}
        self._set("colours", colours)


@dataclass(frozen=True, eq=False)
class Points2D(_Thing):
    """Points in a picture.

    Attributes:
        points: (n, 2) pixels.
        colour: of all.
        radius_px: of each.
        labels: a text beside each, or none.
    """

    points: ArrayLike
    colour: Colour = WHITE
    radius_px: float = 2.0
    labels: Sequence[str] = ()

    def __post_init__(self) -> None:
        _check_labels(self, self._array("points", None, 2), self.labels)
        self._colour()


@dataclass(frozen=True, eq=False)
class Lines2D(_Thing):
    """Lines in a picture.

    Attributes:
        lines: (n, k, 2) pixels: n lines through k points each.
        colour: of all.
        width_px: of each.
    """

    lines: ArrayLike
    colour: Colour = WHITE
    width_px: float = 1.5

    def __post_init__(self) -> None:
        self._array("lines", None, None, 2)
        self._colour()


@dataclass(frozen=True, eq=False)
class Points3D(_Thing):
    """Points in a scene.

    Attributes:
        points: (n, 3) metres.
        colour: of all.
        radius_m: of each.
        labels: a text beside each, or none.
    """

    points: ArrayLike
    colour: Colour = GREY
    radius_m: float = 0.003
    labels: Sequence[str] = ()

    def __post_init__(self) -> None:
        _check_labels(self, self._array("points", None, 3), self.labels)
        self._colour()


@dataclass(frozen=True, eq=False)
class Lines3D(_Thing):
    """Lines in a scene.

    Attributes:
        lines: (n, k, 3) metres: n lines through k points each.
        colour: of all.
        radius_m: of each.
    """

    lines: ArrayLike
    colour: Colour = GREY
    radius_m: float = 0.001

    def __post_init__(self) -> None:
        self._array("lines", None, None, 3)
        self._colour()


@dataclass(frozen=True, eq=False)
class Mesh(_Thing):
    """A surface of triangles.

    Attributes:
        vertices: (n, 3) metres, in the mesh's frame.
        faces: (m, 3) indices of vertices, counter-clockwise seen from outside.
        pose: of the mesh; None: the scene's frame.
        colour: of all faces.
    """

    vertices: ArrayLike
    faces: ArrayLike
    pose: ArrayLike | None = None
    colour: Colour = GREY

    def __post_init__(self) -> None:
        vertices = self._array("vertices", None, 3)
        faces = self._array("faces", None, 3, dtype=np.int64)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError(f"Mesh: faces: expected indices of {len(vertices)} vertices, got up to {faces.max()}")
        self._pose()
        self._colour()


@dataclass(frozen=True, eq=False)
class Box(_Thing):
    """A box.

    Attributes:
        size: lengths along its axes, metres.
        pose: of its centre; None: the scene's frame.
        colour: of the box.
        filled: its faces; else its edges alone.
        label: a text beside it.
    """

    size: ArrayLike
    pose: ArrayLike | None = None
    colour: Colour = GREY
    filled: bool = False
    label: str = ""

    def __post_init__(self) -> None:
        self._array("size", 3)
        self._pose()
        self._colour()


@dataclass(frozen=True, eq=False)
class Axes(_Thing):
    """A frame's axes: x red, y green, z blue.

    Attributes:
        pose: of the frame.
        length_m: of each axis.
    """

    pose: ArrayLike
    length_m: float = 0.05

    def __post_init__(self) -> None:
        self._pose()


@dataclass(frozen=True, eq=False)
class Camera(_Thing):
    """A pinhole camera, which looks along its z axis, y down.

    Attributes:
        pose: scene_from_camera.
        intrinsics: fx, fy, cx, cy in pixels.
        size: width and height in pixels.
        image: what it sees, as for `Image`; None: nothing is shown of it.
        depth_m: how far from the camera its image is drawn.
    """

    pose: ArrayLike
    intrinsics: ArrayLike
    size: tuple[int, int]
    image: ArrayLike | None = None
    depth_m: float = 0.1

    def __post_init__(self) -> None:
        self._pose()
        self._array("intrinsics", 4)
        if self.image is not None:
            self._set("image", Image(self.image).pixels)


@dataclass(frozen=True, eq=False)
class Curve(_Thing):
    """A number, and how its curve is drawn.

    Attributes:
        value: in this epoch.
        colour: of the curve; None: any.
    """

    value: float
    colour: Colour | None = None

    def __post_init__(self) -> None:
        self._set("value", float(self.value))
        if self.colour is not None:
            self._colour()


@dataclass(frozen=True, eq=False)
class Graph(_Thing):
    """Nodes of some kind, and what joins them.

    Attributes:
        nodes: a text for each name; may have several lines.
        edges: pairs of names.
        places: where each node is drawn, (x, y), y down; those that are not said find a place.
        colours: by name.
        directed: whether edges are arrows.
    """

    nodes: Mapping[str, str]
    edges: Sequence[tuple[str, str]] = ()
    places: Mapping[str, tuple[float, float]] | None = None
    colours: Mapping[str, Colour] | None = None
    directed: bool = True

    def __post_init__(self) -> None:
        unknown = sorted({name for edge in self.edges for name in edge} - set(self.nodes))
        if unknown:
            raise ValueError(f"Graph: edges: there is no node {unknown[0]!r}")
        if self.places is not None and set(self.places) != set(self.nodes):
            raise ValueError("Graph: places: expected one for each node, or none at all")
        colours = {name: _colour(colour, f"Graph: colours: {name}") for name, colour in (self.colours or {}).items()}
        self._set("colours", colours)


Picture = Image | Depth | Labels | Points2D | Lines2D
Scene = Mesh | Box | Points3D | Lines3D | Axes | Camera
Thing = Picture | Scene | Curve | Graph | float | str

Things = Mapping[str, Thing]
"""By path."""


def _colour(given: Colour, where: str) -> Colour:
    parts = tuple(int(part) for part in given)
    if len(parts) not in (3, 4) or not all(0 <= part <= 255 for part in parts):
        raise ValueError(f"{where}: expected three or four numbers from 0 to 255, got {given}")
    return parts


def _check_labels(thing: object, points: Array, labels: Sequence[str]) -> None:
    if labels and len(labels) != len(points):
        raise ValueError(f"{type(thing).__name__}: labels: expected {len(points)} or none, got {len(labels)}")
