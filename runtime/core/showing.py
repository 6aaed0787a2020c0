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

Arrays may be lists, too. What is built wrongly is refused with a ValueError that says what was expected."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Colour = tuple[int, ...]  # red, green, blue and perhaps opacity, each 0 to 255

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

    shapes: ClassVar[Mapping[str, tuple[int | None, ...]]] = {}  # of the fields that are arrays; None is any length

    def __post_init__(self) -> None:
        for name, shape in self.shapes.items():
            self._array(name, *shape)
        if hasattr(self, "pose"):
            if self.pose is None:
                self._set("pose", np.eye(4))
            self._array("pose", 4, 4)
        colour = getattr(self, "colour", None)
        if colour is not None:
            self._set("colour", _colour(colour, f"{type(self).__name__}: colour"))
        points, texts = getattr(self, "points", ()), getattr(self, "labels", ())
        if "points" in self.shapes and texts and len(texts) != len(points):
            raise ValueError(f"{type(self).__name__}: labels: expected {len(points)} or none, got {len(texts)}")

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


@dataclass(frozen=True, eq=False)
class Image(_Thing):
    """A picture's ground."""

    pixels: ArrayLike  # (h, w) grey or (h, w, 3) RGB, uint8

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels)
        if pixels.dtype != np.uint8 or not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)):
            raise ValueError(
                f"Image: pixels: expected h × w or h × w × 3 of uint8, got {pixels.dtype} of shape {pixels.shape}"
            )
        self._set("pixels", pixels)


@dataclass(frozen=True, eq=False)
class Depth(_Thing):
    """A picture that says how far away each pixel is."""

    metres: ArrayLike  # (h, w); 0 where nothing is
    shapes: ClassVar = {"metres": (None, None)}


@dataclass(frozen=True, eq=False)
class Labels(_Thing):
    """A picture that says what each pixel belongs to."""

    labels: ArrayLike  # (h, w), 0 to 255; 0 is nothing
    names: Mapping[int, str] | None = None  # by label
    colours: Mapping[int, Colour] | None = None  # by label; else `colour_of` it
    opacity: float = 0.6  # 0 to 1, over what else is in the picture

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
    """Points in a picture."""

    points: ArrayLike  # (n, 2) pixels
    colour: Colour = WHITE  # of all
    radius_px: float = 2.0  # of each
    labels: Sequence[str] = ()  # a text beside each, or none
    shapes: ClassVar = {"points": (None, 2)}


@dataclass(frozen=True, eq=False)
class Lines2D(_Thing):
    """Lines in a picture."""

    lines: ArrayLike  # (n, k, 2) pixels: n lines through k points each
    colour: Colour = WHITE  # of all
    width_px: float = 1.5  # of each
    shapes: ClassVar = {"lines": (None, None, 2)}


@dataclass(frozen=True, eq=False)
class Points3D(_Thing):
    """Points in a scene."""

    points: ArrayLike  # (n, 3) metres
    colour: Colour = GREY  # of all
    radius_m: float = 0.003  # of each
    labels: Sequence[str] = ()  # a text beside each, or none
    shapes: ClassVar = {"points": (None, 3)}


@dataclass(frozen=True, eq=False)
class Lines3D(_Thing):
    """Lines in a scene."""

    lines: ArrayLike  # (n, k, 3) metres: n lines through k points each
    colour: Colour = GREY  # of all
    radius_m: float = 0.001  # of each
    shapes: ClassVar = {"lines": (None, None, 3)}


@dataclass(frozen=True, eq=False)
class Mesh(_Thing):
    """A surface of triangles."""

    vertices: ArrayLike  # (n, 3) metres, in the mesh's frame
    faces: ArrayLike  # (m, 3) indices of vertices, counter-clockwise seen from outside
    pose: ArrayLike | None = None  # of the mesh; None: the scene's frame
    colour: Colour = GREY  # of all faces

    shapes: ClassVar = {"vertices": (None, 3)}

    def __post_init__(self) -> None:
        super().__post_init__()
        vertices = np.asarray(self.vertices)
        faces = self._array("faces", None, 3, dtype=np.int64)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError(f"Mesh: faces: expected indices of {len(vertices)} vertices, got up to {faces.max()}")


@dataclass(frozen=True, eq=False)
class Box(_Thing):
    """A box."""

    size: ArrayLike  # lengths along its axes, metres
    pose: ArrayLike | None = None  # of its centre; None: the scene's frame
    colour: Colour = GREY  # of the box
    filled: bool = False  # its faces; else its edges alone
    label: str = ""  # a text beside it
    shapes: ClassVar = {"size": (3,)}


@dataclass(frozen=True, eq=False)
class Axes(_Thing):
    """A frame's axes: x red, y green, z blue."""

    pose: ArrayLike  # of the frame
    length_m: float = 0.05  # of each axis


@dataclass(frozen=True, eq=False)
class Camera(_Thing):
    """A pinhole camera, which looks along its z axis, y down."""

    pose: ArrayLike  # scene_from_camera
    intrinsics: ArrayLike  # fx, fy, cx, cy in pixels
    size: tuple[int, int]  # width and height in pixels
    image: ArrayLike | None = None  # what it sees, as for `Image`; None: nothing is shown of it
    depth_m: float = 0.1  # how far from the camera its image is drawn

    shapes: ClassVar = {"intrinsics": (4,)}

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.image is not None:
            self._set("image", Image(self.image).pixels)


@dataclass(frozen=True, eq=False)
class Curve(_Thing):
    """A number, and how its curve is drawn."""

    value: float  # in this epoch
    colour: Colour | None = None  # of the curve; None: any

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set("value", float(self.value))


@dataclass(frozen=True, eq=False)
class Graph(_Thing):
    """Nodes of some kind, and what joins them."""

    nodes: Mapping[str, str]  # a text for each name; may have several lines
    edges: Sequence[tuple[str, str]] = ()  # pairs of names
    places: Mapping[str, tuple[float, float]] | None = None  # where each is drawn, (x, y), y down; None: anywhere
    colours: Mapping[str, Colour] | None = None  # by name
    directed: bool = True  # whether edges are arrows

    def __post_init__(self) -> None:
        unknown = sorted({name for edge in self.edges for name in edge} - set(self.nodes))
        if unknown:
            raise ValueError(f"Graph: edges: there is no node {unknown[0]!r}")
        if self.places is not None and set(self.places) != set(self.nodes):
            raise ValueError("Graph: places: expected one for each node, or none at all")
        colours = {name: _colour(colour, f"Graph: colours: {name}") for name, colour in (self.colours or {}).items()}
        self._set("colours", colours)


def in_rows(depth_of: Mapping[str, int], across: float, down: float) -> dict[str, tuple[float, float]]:
    """Places for a graph's nodes: those of one depth side by side, in their order, and so far apart."""
    rows: dict[int, list[str]] = {}
    for name, depth in depth_of.items():
        rows.setdefault(depth, []).append(name)
    return {
        name: ((at - (len(row) - 1) / 2) * across, depth * down)
        for depth, row in rows.items()
        for at, name in enumerate(row)
    }


Picture = Image | Depth | Labels | Points2D | Lines2D
Scene = Mesh | Box | Points3D | Lines3D | Axes | Camera
Thing = Picture | Scene | Curve | Graph | float | str

Things = Mapping[str, Thing]  # by path


def _colour(given: Colour, where: str) -> Colour:
    parts = tuple(int(part) for part in given)
    if len(parts) not in (3, 4) or not all(0 <= part <= 255 for part in parts):
        raise ValueError(f"{where}: expected three or four numbers from 0 to 255, got {given}")
    return parts
