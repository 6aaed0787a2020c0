"""What the tracking nodes believe, observe and expect, field by field: shape, dtype, unit and frame.

Every part is a map that travels as it stands. Array fields carry an `Is`, which `fault` checks; all frames are as in
`hierax.nodes.tracking.math.geometry`: ``a_from_b`` takes coordinates in frame b to coordinates in frame a, and a pose's
covariance stands in the object's frame."""

from collections.abc import Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, TypedDict, Union, final, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.math.geometry import Array, Floats

# Status of an object: the newest image supports its pose; it is known from prediction alone; nobody knows where.
TRACKED, EXPECTED, LOST = "tracked", "expected", "lost"

TABLE = 0  # in the place of a body's id, where bodies are carried by the table


class Is(NamedTuple):
    """What an array is."""

    shape: tuple[int | str, ...]  # numbers, or letters for lengths that differ from value to value
    dtype: str  # numpy's name of it
    meaning: str = ""  # unit and frame


CameraPose = Annotated[Floats, Is((4, 4), "float64", "world_from_camera, m")]
CameraFromObject = Annotated[Floats, Is((4, 4), "float64", "camera_from_object, m")]
WorldFromObject = Annotated[Floats, Is((4, 4), "float64", "world_from_object, m")]
Covariance = Annotated[Floats, Is((6, 6), "float64", "of a twist in the object's frame, m² and rad²")]
Intrinsics = Annotated[Array, Is((4,), "float64", "fx, fy, cx, cy in pixels, pixel centres at integers")]
Upwards = Annotated[Floats, Is((3,), "float64", "unit vector in the object's frame; zeros where nothing carries it")]
Size = tuple[int, int]  # width and height in pixels
Nothing = tuple[()]  # the context and actions of nodes that are given none


class Symmetry(TypedDict):
    """After which motions of its frame a body looks the same."""

    turns: Annotated[Floats, Is(("n", 4, 4), "float64", "object_from_object, m; the identity first")]
    # twists along which it may go on turning: none, about an axis, or about all axes through a point
    free: Annotated[Floats, Is(("k", 6), "float64", "m and rad, object's frame")]


class MayLookAlike(TypedDict, total=False):
    """What looks the same in no other pose has no entry of that."""

    symmetry: Symmetry


def looking_alike(entry: MayLookAlike) -> MayLookAlike:
    """What an entry says of symmetry, alone."""
    return {"symmetry": entry["symmetry"]} if "symmetry" in entry else {}


class Model(MayLookAlike):
    """A triangle mesh."""

    vertices: Annotated[Floats, Is(("n", 3), "float64", "m, object's frame")]
    faces: Annotated[Array, Is(("m", 3), "int32", "numbers of vertices, counter-clockwise seen from outside")]


class FirstPose(TypedDict):
    """An object as it is given to a node at the start."""

    id: int  # label in this scene, 1 to 255
    obj_id: int  # number of its model
    pose: CameraFromObject | None  # camera_from_object in the first frame; None: it is looked for


class FirstBody(FirstPose):
    """As `FirstPose`, but ``pose`` is world_from_object; with its model."""

    model: Model


class _ToldCamera(TypedDict, total=False):
    camera: CameraPose  # of the frame that is seen next, where a tag tells it


@final
class SceneBelief(_ToldCamera):
    """What the world that plays a scene folder is."""

    scene: str  # the folder
    index: int  # which frame is seen next


class ScoredPose(TypedDict):
    """What a results file says of an object in a frame."""

    obj_id: int
    pose: CameraFromObject
    score: float  # 0 to 1
    status: str  # of an object that is `LOST` nothing is written


class Picture(TypedDict):
    """World to arm: what the camera sees."""

    image: Annotated[Array, Is(("...",), "uint8", "grey levels")]  # gray (h, w) or RGB (h, w, 3)
    camera: CameraPose  # as the world says it is
    intrinsics: Intrinsics
    frame: int  # number of the image


class ControlPoints(TypedDict):
    """Points on edges of one object that a camera is expected to see, see `hierax.nodes.tracking.model.controls`."""

    points: Annotated[Floats, Is(("n", 3), "float64", "m, object's frame")]
    tangents: Annotated[Floats, Is(("n", 3), "float64", "unit vectors along the edge, object's frame")]
    inwards: Annotated[Floats, Is(("n", 3), "float64", "unit vectors across the edge, object's frame")]
    kinds: Annotated[NDArray[np.uint8], Is(("n",), "uint8", "0 an outline, 1 a crease, 2 a smooth outline")]
    edges: Annotated[NDArray[np.int32], Is(("n",), "int32", "numbers of edges")]
    faces: Annotated[NDArray[np.int32], Is(("n", 2), "int32", "numbers of patches beside it, -1: none")]
    visible: Annotated[NDArray[np.float32], Is(("n",), "float32", "chance that nothing hides it")]


class Alternative(TypedDict):
    """Another pose that an object may have."""

    pose: WorldFromObject  # world_from_object in the context, camera_from_object in the arm's belief
    controls: ControlPoints  # what would be seen of it there
    kept: bool  # whether it is one of the arm's earlier guesses


class ExpectedObject(MayLookAlike):
    """Spatial to arm, within `Imagery`: where an object is expected, and what of it."""

    id: int
    obj_id: int
    pose: WorldFromObject
    covariance: Covariance
    status: str  # as the arm said last
    support: Upwards  # upwards, where something carries it
    stands: bool  # whether it lies on a face there
    hangs: int  # see `Body`
    controls: ControlPoints  # those that are likely enough to be seen
    others: tuple[Alternative, ...]  # poses that it may have besides


class Sweep(TypedDict):
    """Spatial to arm: poses all over what the camera sees that an object may have of which nothing is known."""

    id: int
    # world_from_place in the context, camera_from_place in the arm's belief, m
    places: Annotated[Floats, Is(("n", 4, 4), "float64", "frames whose z points upwards, m")]
    templates: tuple[Alternative, ...]  # poses that it may have at each place, place_from_object
    rough_m: float  # standard deviation of how high the places are


class Imagery(TypedDict):
    """Spatial to arm: the scene as it is expected to be seen (theory, example 3)."""

    # depth, labels: of the part of the image that holds all bodies; 0 where nothing is
    depth: Annotated[NDArray[np.float32], Is(("h", "w"), "float32", "m along the camera's z")]
    labels: Annotated[NDArray[np.uint8], Is(("h", "w"), "uint8", "ids")]
    camera: CameraPose  # at which it was drawn
    intrinsics: Intrinsics  # of that part
    corner: tuple[int, int]  # left and top of that part in the whole image
    size: Size  # of the whole image
    poses: tuple[ExpectedObject, ...]
    sweeps: tuple[Sweep, ...] | None  # of objects that are missing; None where none ever is


class Looks(TypedDict):
    """What is remembered of one object's looks; see `hierax.nodes.tracking.estimation.appearance`."""

    keys: Annotated[NDArray[np.int64], Is(("s",), "int64", "sides of edges, ascending")]
    colours: Annotated[NDArray[np.float32], Is(("s", "c"), "float32", "grey levels")]
    spread: Annotated[NDArray[np.float32], Is(("s",), "float32", "variance of one channel, grey levels²")]
    weights: Annotated[NDArray[np.float32], Is(("s",), "float32", "frames that it comes from")]
    edges: Annotated[NDArray[np.int64], Is(("e",), "int64", "numbers of edges, ascending")]
    offsets: Annotated[NDArray[np.float32], Is(("e", 2), "float32", "mean offset in pixels, and in how many frames")]
    parts: Annotated[NDArray[np.int64], Is(("p",), "int64", "parts of edges, ascending")]
    hits: Annotated[NDArray[np.float32], Is(("p", 2), "float32", "frames found and looked for, older ones fading")]
    tolerance: float | None  # standard deviation of where edges are beside its model's, m; None: nobody knows yet
    judged: int  # for how many images more that is not asked again
    size: float  # how large it is beside its model, 1 where nobody knows
    bent: Annotated[NDArray[np.int64], Is(("b",), "int64", "numbers of edges, ascending")]
    bends: Annotated[Floats, Is(("b", 3), "float64", "m, object's frame")]  # where they are beside the model's
    slack: Annotated[Floats, Is(("b", 3, 3), "float64", "m², object's frame")]  # covariance of that
    dye: Annotated[NDArray[np.float32], Is(("k",), "float32", "share of its places that have each chromaticity")]
    dyed: float  # frames that this comes from


class _SentObject(TypedDict):
    id: int
    obj_id: int
    covariance: Covariance
    score: float  # how well the image supports the pose, 0 to 1
    status: str  # `TRACKED`, `EXPECTED` or `LOST`
    motion_scale: float  # 0 to 1, how much of a push its latest motion asks for
    sought: bool  # whether it is to be imagined elsewhere, too


class PaperObject(_SentObject):
    """What the arm believes of one object with the paper's update."""

    pose: CameraFromObject  # seen from the belief's camera
    misses: int  # images in a row without support
    # poses that explain the newest image nearly as well
    guesses: Annotated[Floats, Is(("n", 4, 4), "float64", "camera_from_object, m")]
    edges: Annotated[Floats, Is(("n", 2, 3), "float64", "m, object's frame")]  # a dash along the edge at each point


class TrackedObject(PaperObject, MayLookAlike):
    """What the arm believes of one object."""

    before: CameraFromObject  # its pose an image earlier
    nats: float  # by how much it explains the image better than clutter does
    probability: float  # that it is within 5 mm and 5° of the truth; 0 where no image says so
    denied: int  # how many of its misses speak against it
    probation: int  # for how many more images it may turn out to be elsewhere
    lead: float  # of one that is missing: nats by which images in a row had it at the first of its guesses
    # running mean of how far images had it from its predictions
    trend: Annotated[Floats, Is((6,), "float64", "standard deviations")]
    failed_searches: int  # for how many images in a row it was looked for elsewhere and not found
    support: Upwards  # upwards, where something carries it
    stands: bool  # whether it lies on a face there
    hangs: int  # see `Body`
    others: tuple[Alternative, ...]  # what came of that
    controls: ControlPoints  # points on the edges expected to be seen
    slots: Looks  # what it looks like beside them


class _Viewing(TypedDict):
    camera: CameraPose | None  # `ArmNode`'s with the error corrected that all objects show together
    intrinsics: Intrinsics | None
    size: Size | None
    frame: int | None  # the newest image's number


class Together(TypedDict):
    """How errors that last go together."""

    ids: Annotated[NDArray[np.int64], Is(("m",), "int64", "objects")]
    # of the camera's drift, a twist in its frame, and of the pose of each of these objects in the world, a twist in its
    # frame, and its size, a share of that; then of the camera in the image of `Ground`, where there is one, likewise
    covariance: Annotated[Floats, Is(("n", "n"), "float64", "m², m rad, rad², …, n = 6 + 7 m, or 12 + 7 m")]


class Ground(TypedDict):
    """Texture of the table in an older image, see `hierax.nodes.tracking.estimation.ground`."""

    camera: CameraPose  # of that image
    points: Annotated[NDArray[np.int64], Is(("n", 2), "int64", "pixels of that image")]
    patches: Annotated[NDArray[np.uint8], Is(("n", "s", "s"), "uint8", "grey levels about them")]


class Texture(TypedDict):
    """What is known of the table's texture, and where bodies will be before it."""

    # 1 where bodies are expected in the next image, and next to them
    covered: Annotated[NDArray[np.uint8], Is(("h", "w"), "uint8", "cells of 8 pixels")]
    ground: Ground | None  # None where there is none, and while the camera stands still
    alike: float  # how far objects' sizes are from their models', in shares of what is expected of each


class MayKnowTexture(TypedDict, total=False):
    texture: Texture  # where a table is expected


class ArmBelief(_Viewing, MayKnowTexture):
    """What the arm node believes; of camera and image nothing before the first one."""

    reported: CameraPose | None  # the same as the world gave it
    # ``reported @ drift`` is where the camera is expected
    drift: Annotated[Floats, Is((4, 4), "float64", "reported_from_camera, m")]
    together: Together | None  # None while the camera stands still
    objects: tuple[TrackedObject, ...]
    # where some that are missing are looked for in the next image; None where none ever is
    sweeps: tuple[Sweep, ...] | None


class PaperArmBelief(_Viewing):
    """What the arm node believes with the paper's update; fields as in `ArmBelief`."""

    objects: tuple[PaperObject, ...]


AnyArmBelief = ArmBelief | PaperArmBelief


@final
class SeenObject(_SentObject):
    """Arm to spatial: where one object is, in the world."""

    pose: WorldFromObject
    guesses: Annotated[Floats, Is(("n", 4, 4), "float64", "world_from_object, m")]


@final
class SeenCamera(TypedDict):
    """Arm to spatial, after the objects: the camera, corrected."""

    camera: CameraPose
    intrinsics: Intrinsics
    size: Size
    frame: int


Seen = SeenObject | SeenCamera


class Cube(TypedDict):
    """What the simulated world knows of one cube: the truth."""

    id: int
    obj_id: int
    side_m: float  # length of its edges, metres
    colour: tuple[int, int, int]  # red, green, blue, 0 to 255
    pose: WorldFromObject
    velocity: Annotated[Floats, Is((6,), "float64", "m/s and rad/s, world frame")]  # of its origin, and its turning


@final
class SimBelief(TypedDict):
    """What the simulated world is."""

    frame: int  # number of the image that is seen next
    time_s: float  # of it
    camera: CameraPose
    intrinsics: Intrinsics
    size: Size
    noise: float  # standard deviation of the sensor's noise, grey levels of 256
    blur_px: float  # standard deviation of the lens's blur, pixels
    bodies: tuple[Cube, ...]


class Body(TypedDict):
    """What the spatial node believes of one body."""

    id: int
    obj_id: int
    pose: WorldFromObject
    velocity: Annotated[Floats, Is((6,), "float64", "m/s and rad/s, world frame")]  # of its origin, and its turning
    # the same as observed, also where it may be nothing but errors
    drift: Annotated[Floats, Is((6,), "float64", "m/s and rad/s, world frame")]
    covariance: Covariance
    status: str  # as the arm said last
    seen: WorldFromObject | None  # the pose that the last observation gave it; None where it was not tracked
    unseen: int  # for how many observations it was not
    support: Upwards  # upwards, where something carries it
    stands: bool  # whether it lies on a face there
    hangs: int  # for how many images it was tracked where nothing carries it, or where it does not lie on a face
    known: bool  # whether it was ever tracked
    sought: bool  # sought, guesses: as the arm gave them
    turn: int  # how often it was imagined elsewhere, or looked for everywhere
    guesses: Annotated[Floats, Is(("n", 4, 4), "float64", "world_from_object, m")]
    # where it may be besides, the first ``kept`` of them the guesses
    others: Annotated[Floats, Is(("n", 4, 4), "float64", "world_from_object, m")]
    kept: int
    model: Model
    mass: float  # kg


class SpatialBelief(_Viewing):
    """What the spatial node believes; of the camera nothing before the first observation."""

    images: int  # how many have been told of
    time_s: float | None  # of the last observation
    interval_s: float  # from the one before to it
    # ids of missing bodies that are looked for everywhere in the next image; None: none is ever missing
    sweeping: tuple[int, ...] | None
    bodies: tuple[Body, ...]
    # pairs of ids: a body, and what carries it by the physics of the last γ: another one, or `TABLE`
    carried: tuple[tuple[int, int], ...]


def fault(value: Any, kind: Any, where: str) -> str:
    """What is wrong with a belief, an observation, or a part of one, which is called `where`, that should be of one of
    the kinds above, or as one of their fields is annotated; empty where nothing is."""
    return next(_faults(value, kind, where), "")


def _faults(value: Any, kind: Any, where: str) -> Iterator[str]:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        yield from _array_faults(value, inner[1], where)
    elif origin in (Union, UnionType):
        if value is not None or NoneType not in inner:
            yield from _faults(value, next(each for each in inner if each is not NoneType), where)
    elif origin is tuple and not isinstance(value, tuple):
        yield f"{where}: expected a tuple, got {type(value).__name__}"
    elif origin is tuple:
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        if len(kinds) != len(value):
            yield f"{where}: expected {len(kinds)} entries, got {len(value)}"
        for at, (part, each) in enumerate(zip(value, kinds, strict=False)):
            yield from _faults(part, each, f"{where}[{at}]")
    elif hasattr(kind, "__total__"):
        hints = get_type_hints(kind, include_extras=True)
        if not isinstance(value, Mapping) or not kind.__required_keys__ <= value.keys() <= hints.keys():
            given = sorted(value) if isinstance(value, Mapping) else type(value).__name__
            yield f"{where}: expected a map with the keys {sorted(hints)}, got {given}"
        for name in value:
            yield from _faults(value[name], hints[name], f"{where}.{name}")
    elif not isinstance(value, (int, float) if kind is float else kind) or isinstance(value, bool) != (kind is bool):
        yield f"{where}: expected {kind.__name__}, got {type(value).__name__}"


def _array_faults(value: Any, wanted: Is, where: str) -> Iterator[str]:
    if not isinstance(value, np.ndarray) or value.dtype.name != wanted.dtype:
        given = f"{value.dtype} array" if isinstance(value, np.ndarray) else type(value).__name__
        yield f"{where}: expected an array of {wanted.dtype} ({wanted.meaning}), got {given}"
    elif wanted.shape != ("...",) and (
        len(value.shape) != len(wanted.shape)
        or any(want != got for want, got in zip(wanted.shape, value.shape, strict=True) if isinstance(want, int))
    ):
        yield f"{where}: expected the shape {wanted.shape} ({wanted.meaning}), got {value.shape}"
