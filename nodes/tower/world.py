"""The world of the tower building arm: that of the picking one, which also knows by the truth what was built."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.panda import gripper_at
from hierax.nodes.picking.world import PickWorld
from hierax.nodes.tower.goals import Tower, orders_of, read_towers
from hierax.nodes.tower.interferences import ACTS
from hierax.nodes.tower.person import NOBODY, Seen, acted, drawn_for, is_about_to, moved, obstacles, seen_of
from hierax.runtime import NO_TICK, Elements, Tick, Value

NONE = "none"  # in place of what a person does: nobody is there
DONE_S = 1.0  # a tower is done when it has stood for so long with the hand away from it

_UPRIGHT = 0.99  # cosine of how far a cube may lean
_TOUCHES_M = 0.005  # so much higher or lower than it should be, a cube does not stand on the one below
_AWAY_M = 0.06  # so far from the gripper a cube is not held
_RAISED_M = 0.03  # a cube was moved when it was so high above where it stood


class TowerWorld(PickWorld):
    """An arm over a table with cubes, of which towers are asked for.

    The belief is that of `PickWorld`, with ``done_s`` (how long all towers have stood), ``actions`` (how many times a
    cube was raised by the hand), ``raised`` (the cubes that are), ``rests`` (of each cube, how high it is where it
    rests), ``person`` (see `hierax.nodes.tower.person`) and ``obstacles``, the boxes of which a hand of that person
    consists in pictures.

    Args: tower: as `hierax.nodes.tower.goals.read_towers` has it; person: what somebody does to the towers, one of
        `hierax.nodes.tower.interferences.ACTS`, or several, one after the other; ``none``: nothing; the others as
        `PickWorld` has them.
    Raises ValueError: the tower cannot be built of these cubes, or nobody does such a thing."""

    def __init__(
        self,
        tower: Any,
        person: str | Sequence[str] = NONE,
        scene: int = 0,
        cubes: int = CUBES,
        frames: int = 2400,
        width: int = 640,
        height: int = 480,
        noise: float = 2.0,
        blur_px: float = 0.7,
        fps: int = 20,
        acceleration_m_s2: float = 0.5,
    ) -> None:
        super().__init__(scene, cubes, frames, width, height, noise, blur_px, fps, acceleration_m_s2)
        self._towers, self._scene = read_towers(tower, cubes), scene
        self._acts = _read_acts(person)
        rests = {str(body["id"]): float(body["pose"][2, 3]) for body in self._first["bodies"]}
        counted = {"done_s": 0.0, "actions": 0, "raised": (), "rests": rests}
        self._first = {**self._first, **counted, "person": NOBODY, "obstacles": ()}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """γ of `PickWorld` with a person, and what has come of it."""
        person, guest = belief["person"], None
        if len(person["over"]) < len(self._acts):
            person, guest = acted(person, self._seen(belief, tick.seed), self._acts, 1.0 / self._fps)
        after, left = self.advanced(actions, belief, guest)
        person = person if left is None else moved(person, left.pose, left.velocity)
        return {**self._counted(belief, after), "person": person, "obstacles": obstacles(person)}

    def _counted(self, belief: Value, after: Value) -> Value:
        """What has become of the towers, and of what the arm has raised, beside a frame before."""
        bodies = {body["id"]: body for body in after["bodies"]}
        raised, rests = set(belief["raised"]), dict(belief["rests"])
        begun, gripper = 0, gripper_at(after["joints"])
        for number, body in bodies.items():
            height = float(body["pose"][2, 3])
            is_near = float(np.linalg.norm(body["pose"][:3, 3] - gripper[:3, 3])) < _AWAY_M
            if is_near and height > rests[str(number)] + _RAISED_M:
                begun += number not in raised
                raised.add(number)
            elif not is_near:
                raised.discard(number)
                rests[str(number)] = height
        stands = self._all_built(after) and not raised
        done_s = belief["done_s"] + 1.0 / self._fps if stands else 0.0
        counted = {"actions": belief["actions"] + begun, "raised": tuple(sorted(raised)), "rests": rests}
        return {**after, **counted, "done_s": done_s}

    def finished(self, belief: Value) -> bool:
        """Whether all towers have stood long enough and nobody is about to do something to them, or the frames are
        over."""
        if belief["frame"] >= self._frames or belief["done_s"] < DONE_S - 1e-9:
            return bool(belief["frame"] >= self._frames)
        return not is_about_to(belief["person"], self._seen(belief, 0), self._acts)

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """By the truth: how many towers stand, how far the middle of a cube in them is beside that of the one below at
        most (mm; -1 where none stands on another), how many times a cube was raised, and in how many
        interferences of somebody one was gripped or moved."""
        bodies = {body["id"]: body for body in belief["bodies"]}
        done = [order for tower in self._towers if (order := _order_built(tower, bodies)) is not None]
        beside = [_beside_mm(bodies[upper], bodies[lower]) for tower in done for lower, upper in pairwise(tower)]
        return {
            "towers_done": float(len(done)),
            "placed_mm_max": max(beside, default=-1.0),
            "actions": float(belief["actions"]),
            "interferences": float(belief["person"]["happened"]),
        }

    def _seen(self, belief: Value, seed: int) -> Seen:
        """What the person sees."""
        bodies = {body["id"]: body for body in belief["bodies"]}
        built = [_order_built(tower, bodies) for tower in self._towers]
        left = [tower for tower, order in zip(self._towers, built, strict=True) if order is None]
        orders = [order for tower in left for order in orders_of(tower)] or [built[-1] or ()]  # all stand: the last one
        order = max(orders, key=lambda order: _height_of(order, bodies))
        drawn = partial(drawn_for, seed, self._scene, count=len(self._acts))
        return seen_of(belief, order, _height_of(order, bodies), drawn)

    def _all_built(self, belief: Value) -> bool:
        bodies = {body["id"]: body for body in belief["bodies"]}
        return all(_order_built(tower, bodies) is not None for tower in self._towers)


def _read_acts(person: str | Sequence[str]) -> tuple[str, ...]:
    given = [person] if isinstance(person, str) else person
    if not isinstance(given, list | tuple) or any(name != NONE and name not in ACTS for name in given):
        raise ValueError(f"person is {person!r}; expected {NONE}, or one of {', '.join(ACTS)}, or a list of such")
    return tuple(name for name in given if name != NONE)


def _height_of(order: tuple[int, ...], bodies: Mapping[int, Mapping[str, Any]]) -> int:
    """How many cubes of a tower stand as they should, from the bottom up, whatever is on the last of them."""
    return next((count for count in range(len(order), 0, -1) if _stands(order[:count], bodies)), 0)


def _order_built(tower: Tower, bodies: Mapping[int, Mapping[str, Any]]) -> tuple[int, ...] | None:
    """In which order a tower stands, from the bottom up; None: it does not."""
    return next((order for order in orders_of(tower) if _is_built(order, bodies)), None)


def _is_built(tower: tuple[int, ...], bodies: Mapping[int, Mapping[str, Any]]) -> bool:
    """Whether each cube of a tower stands on the one below, the first one on the table, and nothing on the last."""
    if not _stands(tower, bodies):
        return False
    top = bodies[tower[-1]]
    others = [body for number, body in bodies.items() if number not in tower]
    return not any(
        _beside_mm(body, top) < 1000.0 * body["side_m"] and body["pose"][2, 3] > top["pose"][2, 3] for body in others
    )


def _stands(tower: tuple[int, ...], bodies: Mapping[int, Mapping[str, Any]]) -> bool:
    """Whether each cube of a tower stands on the one below, the first one on the table."""
    height = 0.0
    for level, number in enumerate(tower):
        body = bodies[number]
        height += body["side_m"]
        if abs(float(body["pose"][2, 3]) + body["side_m"] / 2 - height) > _TOUCHES_M * (level + 1):
            return False
        if float(np.abs(body["pose"][2, :3]).max()) < _UPRIGHT:
            return False
        if level and _beside_mm(body, bodies[tower[level - 1]]) > 500.0 * bodies[tower[level - 1]]["side_m"]:
            return False
    return True


def _beside_mm(upper: Mapping[str, Any], lower: Mapping[str, Any]) -> float:
    return 1000.0 * float(np.linalg.norm(upper["pose"][:2, 3] - lower["pose"][:2, 3]))
