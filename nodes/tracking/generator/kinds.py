"""Kinds of generated scenes: what stands where, and from where it is seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hierax.nodes.tracking.generator import stock
from hierax.nodes.tracking.generator.camera import Swing, camera_path
from hierax.nodes.tracking.generator.knocked import knocked
from hierax.nodes.tracking.generator.pushed import pushed
from hierax.nodes.tracking.generator.worn import RADIUS_M, rounded, worn
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.simworld.light import Lamp
from hierax.nodes.tracking.simworld.raster import visible_shares
from hierax.nodes.tracking.simworld.scene import Wood
from hierax.nodes.tracking.simworld.shapes import Thing

SIZE = (640, 480)
FOCAL_PX = 610.0
INTRINSICS = np.array([FOCAL_PX, FOCAL_PX, 318.4, 241.2])

IMPRECISE = "imprecise"  # the kind whose models lie beside the objects
# Of the kind "taken": the first frame in which one is taken out, after how many the next one is, and for how many it is
# away: so high over the table that it is behind the camera.
_TAKEN_FROM, _TAKEN_EVERY, _TAKEN_FRAMES, _OUT_M = 40, 15, 20, 50.0
CROWDED, CROWD = "crowded", 20  # the kind with so many objects
_CANDIDATES = 40
_FEW = 8  # of curved things, which take longer to be looked at
_LOOKS = 6
_COARSE = 4  # candidates are looked at in pictures that are smaller by this
_COARSE_SIZE = SIZE[0] // _COARSE, SIZE[1] // _COARSE
_COARSE_INTRINSICS = (INTRINSICS + np.array([0.0, 0.0, 0.5, 0.5])) / _COARSE - np.array([0.0, 0.0, 0.5, 0.5])


@dataclass(frozen=True)
class Film:
    """A scene in motion, all of it true."""

    things: Sequence[Thing]  # the objects
    poses: Floats  # (frames, objects, 4, 4) world_from_object
    camera: Floats  # (frames, 4, 4) world_from_camera
    lamp: Lamp  # lamp, wood: the light and the table
    wood: Wood
    strangers: Sequence[Thing] = ()  # things that no model is given of
    stranger_poses: Floats = field(default_factory=lambda: np.zeros((0, 0, 4, 4)))  # (frames, strangers, 4, 4)
    still: bool = False  # whether start and camera are exact by the kind's nature
    turned: bool = False  # whether things come to lie on other faces: those that look alike are not told apart then

    def first(self, objects: int | None) -> "Film":
        """The film with so many of its objects at most. Raises ValueError: `objects` is not positive."""
        if objects is None:
            return self
        if objects < 1:
            raise ValueError(f"objects is {objects}; expected at least 1")
        return replace(self, things=self.things[:objects], poses=self.poses[:, :objects])

    def bodies(self, frame: int) -> list[Thing]:
        """Everything where it is in a frame, the objects first."""
        poses = [*self.poses[frame], *(self.stranger_poses[frame] if self.strangers else ())]
        every = zip((*self.things, *self.strangers), poses, strict=True)
        return [thing._replace(pose=pose) for thing, pose in every]


def film(kind: str, seed: int, frames: int) -> Film:
    """A scene of a kind; kind: one of `KINDS`; seed: draws everything in it; frames: how many. Raises ValueError:
    there is no such kind, or `frames` is not positive."""
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; expected one of {', '.join(KINDS)}")
    if frames < 1:
        raise ValueError(f"frames is {frames}; expected at least 1")
    rng = np.random.default_rng([seed, *kind.encode()])
    return KINDS[kind](rng, frames)


def _scattered(rng: np.random.Generator, frames: int) -> Film:
    return _still_life(rng, frames, lambda: stock.scattered(_items(rng), rng, 0.17, 0.02), _swing(rng, 40.0))


def _crowded(rng: np.random.Generator, frames: int) -> Film:
    """Twenty small boxes."""
    paints = stock.colours(rng, CROWD)
    items = [stock.small_box(rng, paint) for paint in paints]
    return _still_life(rng, frames, lambda: stock.scattered(items, rng, 0.15, 0.006), _swing(rng, 48.0), tries=_FEW)


def _hidden(rng: np.random.Generator, frames: int) -> Film:
    return _still_life(
        rng, frames, lambda: stock.scattered(_items(rng), rng, 0.11, 0.004), _swing(rng, 24.0), _half_hidden
    )


def _worn(rng: np.random.Generator, frames: int) -> Film:
    """Objects that hide one another, each with all its edges worn alike; one in five is sharp."""
    shown = _hidden(rng, frames)
    radii = rng.uniform(-0.25 * RADIUS_M, RADIUS_M, len(shown.things))
    seen = [thing._replace(shape=rounded(thing.shape, r)) for thing, r in zip(shown.things, radii, strict=True)]
    return replace(shown, things=seen)


def _alike(rng: np.random.Generator, frames: int) -> Film:
    """Objects of one paint that hide one another, in light from everywhere: where they meet hardly an edge is seen."""

    def things() -> list[Thing] | None:
        items = _items(rng)
        return stock.scattered([item._replace(colour=items[0].colour) for item in items], rng, 0.11, 0.004)

    shown = _still_life(rng, frames, things, _swing(rng, 24.0), _half_hidden)
    return replace(shown, lamp=replace(shown.lamp, ambient=0.85, diffuse=0.15))


def _tower(rng: np.random.Generator, frames: int) -> Film:
    def towers() -> list[Thing] | None:
        paints = stock.colours(rng, 6)
        widths = np.sort(rng.uniform(0.05, 0.09, 6))[::-1]
        flat = [stock.flat_box(rng, paint, width) for paint, width in zip(paints, widths, strict=True)]
        first = stock.stacked([flat[0], flat[2], flat[4]], rng, -0.06, rng.uniform(-0.03, 0.03))
        second = stock.stacked([flat[1], flat[3]], rng, 0.06, rng.uniform(-0.03, 0.03))
        single = stock.scattered([stock.random_mesh(rng, paints[5])], rng, 0.16, 0.01, [*first, *second])
        return None if single is None else [*first, *second, *single]

    return _still_life(rng, frames, towers, _swing(rng, 30.0))


def _approach(rng: np.random.Generator, frames: int) -> Film:
    swing = _swing(rng, 36.0)._replace(radius_m=(rng.uniform(0.85, 0.95), rng.uniform(0.42, 0.48)), swing_deg=10.0)
    return _still_life(rng, frames, lambda: stock.scattered(_items(rng), rng, 0.12, 0.015), swing)


def _low_contrast(rng: np.random.Generator, frames: int) -> Film:
    grey = rng.uniform(120.0, 150.0)

    def boxes() -> list[Thing] | None:
        paints = stock.greys(rng, 5 + int(rng.integers(2)), grey)
        return stock.scattered([stock.random_box(rng, paint) for paint in paints], rng, 0.14, 0.01)

    level = round(grey)
    wood = Wood((level, level - 1, level - 3), 0.5, int(rng.integers(1, 1000)))
    return _still_life(rng, frames, boxes, _swing(rng, 32.0), wood=wood)


def _imprecise(rng: np.random.Generator, frames: int) -> Film:
    """Boxes and a wedge from near by, of which the models tell sides, edges and size a little wrong."""
    paints = stock.colours(rng, 5)
    drawn = [stock.random_wedge(rng, paints[0]), *(stock.random_box(rng, paint) for paint in paints[1:])]
    made = [item._replace(shape=worn(item.shape, rng)) for item in drawn]
    swing = _swing(rng, 38.0)
    swing = swing._replace(radius_m=(0.75 * swing.radius_m[0], 0.75 * swing.radius_m[1]))
    shown = _still_life(rng, frames, lambda: stock.scattered(made, rng, 0.13, 0.015), swing)
    told = [thing.shape._replace(mesh=item.shape.mesh) for thing, item in zip(shown.things, drawn, strict=True)]
    things = [thing._replace(shape=shape) for thing, shape in zip(shown.things, told, strict=True)]
    return replace(shown, things=things)


def _curved(rng: np.random.Generator, frames: int) -> Film:
    """A mug, a bottle, a ball, a cylinder, standing or lying, and a torus."""
    paints = stock.colours(rng, 5)
    lying = np.roll(np.eye(3), 1, axis=0) if rng.random() < 0.5 else np.eye(3)
    items = [
        stock.Item(stock.mug(rng.uniform(0.03, 0.042), rng.uniform(0.08, 0.1)), np.eye(3), paints[0]),
        stock.Item(stock.bottle(rng.uniform(0.025, 0.032), rng.uniform(0.12, 0.16)), np.eye(3), paints[1]),
        stock.Item(stock.ball(rng.uniform(0.025, 0.04)), np.eye(3), paints[2]),
        stock.Item(stock.cylinder(rng.uniform(0.022, 0.036), rng.uniform(0.05, 0.1)), lying, paints[3]),
        stock.Item(stock.torus(rng.uniform(0.03, 0.042), rng.uniform(0.009, 0.014)), np.eye(3), paints[4]),
    ]
    return _still_life(rng, frames, lambda: stock.scattered(items, rng, 0.15, 0.015), _swing(rng, 34.0), tries=_FEW)


def _figures(rng: np.random.Generator, frames: int) -> Film:
    """Five of those objects of pybullet's data that `stock` names."""
    names = rng.permutation(list(stock.FOUND))[:5]
    items = [stock.found_thing(str(name), paint) for name, paint in zip(names, stock.colours(rng, 5), strict=True)]
    return _still_life(rng, frames, lambda: stock.scattered(items, rng, 0.15, 0.015), _swing(rng, 38.0), tries=_FEW)


def _pushed(rng: np.random.Generator, frames: int) -> Film:
    things, poses, camera, rod, rods = pushed(rng, frames, INTRINSICS, SIZE)
    return Film(things, poses, camera, _lamp(rng), _wood(rng), [rod], rods[:, None], still=True)


def _knocked(rng: np.random.Generator, frames: int) -> Film:
    """Objects that stand far apart, and are knocked over or slide away, one after the other."""
    swing = _swing(rng, 36.0)
    far = swing._replace(radius_m=(1.2 * swing.radius_m[0], 1.2 * swing.radius_m[1]))
    shown = _still_life(rng, frames, lambda: stock.scattered(_items(rng), rng, 0.15, 0.03), far)
    return replace(shown, poses=knocked(shown.things, rng, frames), turned=True)


def _taken(rng: np.random.Generator, frames: int) -> Film:
    """Objects that are taken out, one after the other, and put in elsewhere a little later."""
    shown = _still_life(rng, frames, lambda: stock.scattered(_items(rng)[:5], rng, 0.15, 0.02), _swing(rng, 40.0))
    poses = shown.poses.copy()
    for number, frame in enumerate(range(_TAKEN_FROM, frames, _TAKEN_EVERY)):
        at, back = number % len(shown.things), frame + _TAKEN_FRAMES
        poses[frame:, at, 2, 3] = _OUT_M
        if back < frames:
            every = [thing._replace(pose=pose) for thing, pose in zip(shown.things, poses[back], strict=True)]
            others = [thing for thing in every if thing.pose[2, 3] < _OUT_M / 2]
            poses[back:, at] = _elsewhere(shown.things[at], others, rng)
    return replace(shown, poses=poses)


def _elsewhere(thing: Thing, others: Sequence[Thing], rng: np.random.Generator) -> Floats:
    """A pose in which a thing finds room beside others, as it lay."""
    item = stock.Item(thing.shape, thing.pose[:3, :3], thing.colour)
    placed = next(found for _ in range(_CANDIDATES) if (found := stock.scattered([item], rng, 0.17, 0.015, others)))
    return placed[0].pose


def _items(rng: np.random.Generator) -> list[stock.Item]:
    count = 5 + int(rng.integers(2))
    paints = stock.colours(rng, count)
    meshes = 1 + int(rng.integers(2))
    made = [stock.random_mesh] * meshes + [stock.random_box] * (count - meshes)
    return [make(rng, paint) for make, paint in zip(made, paints, strict=True)]


def _mostly_seen(hidden: Floats) -> float:
    """High where little is hidden."""
    return -float((hidden**2).mean()) - float((hidden > 0.6).mean())


def _half_hidden(hidden: Floats) -> float:
    """High where many objects are 30 to 80 % hidden, and none of them nearly all the time, or at first."""
    wanted = ((hidden > 0.3) & (hidden < 0.8)).mean()
    return float(wanted - 2.0 * (hidden > 0.88).mean() - 2.0 * (hidden[0] > 0.8).mean())


def _still_life(
    rng: np.random.Generator,
    frames: int,
    arranged: Callable[[], list[Thing] | None],
    swing: Swing,
    merit: Callable[[Floats], float] = _mostly_seen,
    wood: Wood | None = None,
    tries: int = _CANDIDATES,
) -> Film:
    """Of many arrangements the one that looks best for its purpose, along the whole path."""
    best: tuple[float, list[Thing], Floats] | None = None
    for _ in range(tries):
        things = arranged()
        if things is None:
            continue
        target = np.mean([thing.pose[:3, 3] for thing in things], axis=0)
        path = camera_path(swing, target, frames, rng)
        looks = np.linspace(0, frames - 1, _LOOKS).astype(int)
        shares = np.array([visible_shares(things, path[at], _COARSE_INTRINSICS, _COARSE_SIZE) for at in looks])
        value = merit(1.0 - shares)
        if best is None or value > best[0]:
            best = (value, things, path)
    assert best is not None, "of many tries one finds room"
    _, things, path = best
    poses = np.repeat(np.array([thing.pose for thing in things])[None], frames, axis=0)
    return Film(things, poses, path, _lamp(rng), wood or _wood(rng))


def _swing(rng: np.random.Generator, elevation_deg: float) -> Swing:
    distance = rng.uniform(0.56, 0.68)
    return Swing(
        azimuth_deg=rng.uniform(-180.0, 180.0),
        elevation_deg=elevation_deg + rng.uniform(-3.0, 3.0),
        radius_m=(distance, distance + rng.uniform(-0.04, 0.04)),
        swing_deg=rng.uniform(16.0, 24.0),
        period_s=rng.uniform(4.0, 6.0),
        phase=rng.uniform(0.0, 2.0 * np.pi),
    )


def _lamp(rng: np.random.Generator) -> Lamp:
    """Hard light from one side: shadows that are stronger than most edges of objects."""
    turn, height = rng.uniform(-np.pi, np.pi), rng.uniform(1.0, 1.6)
    return Lamp((float(np.cos(turn)), float(np.sin(turn)), float(height)), rng.uniform(0.015, 0.07), 0.34, 0.80)


def _wood(rng: np.random.Generator) -> Wood:
    """Planks or, one time in three, tiles, whose edges are as strong as those of objects."""
    warm, cool = rng.uniform(0.75, 1.1), rng.uniform(0.0, 1.0)
    colour = (round((160 - 24 * cool) * warm), round(134 * warm), round((104 + 28 * cool) * warm))
    unevenness, grain = rng.uniform(0.8, 1.6), int(rng.integers(1000))
    tile_m = rng.uniform(0.04, 0.09) if rng.random() < 1.0 / 3.0 else 0.0
    return Wood(colour, unevenness, grain, tile_m)


# By name.
KINDS: dict[str, Callable[[np.random.Generator, int], Film]] = {
    "scattered": _scattered,
    CROWDED: _crowded,
    "hidden": _hidden,
    "worn": _worn,
    "alike": _alike,
    "tower": _tower,
    "approach": _approach,
    "low-contrast": _low_contrast,
    IMPRECISE: _imprecise,
    "pushed": _pushed,
    "knocked": _knocked,
    "curved": _curved,
    "figures": _figures,
    "taken": _taken,
}
