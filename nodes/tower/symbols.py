"""Symbols from beliefs: which cube is on which, as probabilities of poses with covariances and of contacts, with
hysteresis.

A symbol begins to hold when its probability reaches `BEGINS`, and ends below `ENDS`; in between it is what it was, so
that a pose at the edge does not make it come and go. Either has to be so for `CONFIRMED` epochs in a row, as a pose may
be wrong for an instant. Of cubes that are not seen just now, what held goes on to hold, as nothing speaks against it;
so it does while the hand is among the cubes, as from near poses are wrong for longer than that: then symbols begin
of cubes alone of which none held. Of one that stays lost while the arm looks for it nothing holds but that it is
unknown."""

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tower.placing import half_height
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.schema import LOST, TABLE, TRACKED

BEGINS, ENDS, CONFIRMED = 0.9, 0.5, 8
LEAST = 0.01  # what is less likely is not noted
PATIENCE = 40  # epochs that the arm looks for a lost cube before what was known of it is given up
GAP_M = 0.008  # so far from touching, what rests on something may seem to be
MODEL_M = 0.001  # standard deviation of what covariances do not tell of: models, and the camera's height
# How much less likely it is that one cube rests on another where physics has that not carry it. That it does says
# nothing more: what hovers by 12 mm falls onto it within a frame of imagination.
UNCARRIED = 0.05
IN_HAND_M = 0.006  # so much wider or narrower than the cube, fingers may be that hold it

Pair = tuple[int, int]


class Told(NamedTuple):
    """What symbols follow from."""

    bodies: Sequence[Mapping[str, Any]]  # as `hierax.nodes.picking.tracker.scene_known` tells them
    carried: Collection[Pair]  # which of them what carries, by physics: pairs of ids, or of an id and `TABLE`
    holding: int | None  # the cube that the skills node has the hand hold
    gripper: Floats  # world_from_gripper
    width_m: float  # between the fingers
    looking: bool  # whether the arm does nothing but look


class Symbols(NamedTuple):
    """What is held to be so; ids of cubes, ascending."""

    on: tuple[Pair, ...]  # (upper, lower)
    on_table: tuple[int, ...]
    unknown: tuple[int, ...]
    holding: int | None  # the cube in the hand
    # By symbol, as ``on 3 1``, ``on_table 1``, ``clear 1``, ``holding 4`` or ``unknown 2``, its probability, of those
    # that are not impossible. That a cube is unknown is said of the builder itself, and certain.
    certainty: Mapping[str, float]
    lost: tuple[Pair, ...] = ()  # cubes that are lost, and in how many epochs the arm has looked in vain
    doubts: Mapping[str, int] = {}  # by symbol, in how many epochs just now it should have been otherwise

    @property
    def below(self) -> dict[int, int]:
        """Of each cube that stands on another one, that."""
        return dict(self.on)

    def above(self, cube: int) -> list[int]:
        """The cubes that stand on one, the highest last."""
        found: list[int] = []
        upper = {lower: upper for upper, lower in self.on}
        while cube in upper and upper[cube] not in found:
            cube = upper[cube]
            found.append(cube)
        return found

    def is_clear(self, cube: int) -> bool:
        """Whether nothing stands on a cube."""
        return not self.above(cube)


NOTHING = Symbols((), (), (), None, {})


def symbols_after(before: Symbols, told: Told) -> Symbols:
    """What holds by what is told, after what held before."""
    lost = dict(before.lost)
    lost = {body["id"]: lost.get(body["id"], 0) + told.looking for body in told.bodies if body["status"] == LOST}
    unknown = sorted(cube for cube, epochs in lost.items() if epochs >= PATIENCE and cube != told.holding)
    known = {body["id"]: body for body in told.bodies if body["id"] not in unknown}
    free = [cube for cube in known if cube != told.holding]
    chances = {pair: _chance(pair, known, told) for pair in permutations(free, 2)}
    chances |= {(cube, TABLE): _chance((cube, TABLE), known, told) for cube in free}
    held = {*before.on, *((cube, TABLE) for cube in before.on_table)}
    holds, doubts = _settled(chances, held, before.doubts, known, told.looking)
    on = tuple(sorted(pair for pair in holds if pair[1] != TABLE))
    on_table = tuple(sorted(cube for cube, lower in holds if lower == TABLE))
    certainty = {_name(pair): chance for pair, chance in chances.items()}
    certainty |= {f"clear {cube}": _chance_clear(cube, chances) for cube in known}
    certainty |= {f"unknown {cube}": 1.0 for cube in unknown}
    if told.holding is not None:
        certainty[f"holding {told.holding}"] = chance_held(known[told.holding], told.gripper, told.width_m)
    certainty = {symbol: chance for symbol, chance in certainty.items() if chance >= LEAST}
    return Symbols(on, on_table, tuple(unknown), told.holding, certainty, tuple(sorted(lost.items())), doubts)


def _settled(
    chances: Mapping[Pair, float],
    held: Collection[Pair],
    doubts: Mapping[str, int],
    known: Mapping[int, Mapping[str, Any]],
    looking: bool,
) -> tuple[list[Pair], dict[str, int]]:
    """Which of some pairs hold now, and the doubts that are left."""
    settled = {upper for upper, _ in held}
    holds, left = [], {}
    for pair, chance in chances.items():
        was = pair in held
        seen = all(known[cube]["status"] == TRACKED for cube in pair if cube != TABLE)
        should = chance >= (ENDS if was else BEGINS) if seen else was
        epochs = 0
        if should != was and (looking or pair[0] not in settled):
            epochs = doubts.get(_name(pair), 0) + 1
        if epochs >= CONFIRMED:
            was = should
        elif epochs:
            left[_name(pair)] = epochs
        if was:
            holds.append(pair)
    return holds, left


def _name(pair: Pair) -> str:
    upper, lower = pair
    return f"on_table {upper}" if lower == TABLE else f"on {upper} {lower}"


def _chance(pair: Pair, known: Mapping[int, Mapping[str, Any]], told: Told) -> float:
    """The probability that one rests on the other, by poses and by what carries it."""
    upper, lower = pair
    chance = chance_on_table(known[upper]) if lower == TABLE else chance_on(known[upper], known[lower])
    if pair in told.carried:
        return chance
    return UNCARRIED * chance / (UNCARRIED * chance + 1.0 - chance)


def _chance_clear(cube: int, chances: Mapping[Pair, float]) -> float:
    """The probability that nothing rests on a cube."""
    return math.prod(1.0 - chance for (_, lower), chance in chances.items() if lower == cube)


def chance_held(body: Mapping[str, Any], gripper: Floats, width_m: float) -> float:
    """The probability that a box is between the fingers: the gripper's middle within it, and they as far apart as one
    of its sides is long."""
    away = gripper[:3, :3].T @ (body["pose"][:3, 3] - gripper[:3, 3])
    deviations = _deviations(gripper[:3, :3].T, body)
    inside = [
        _within(float(off), 0.5 * float(min(body["size"])), sigma) for off, sigma in zip(away, deviations, strict=True)
    ]
    return math.prod(inside) * max(_within(width_m - float(side), IN_HAND_M, MODEL_M) for side in body["size"])


def chance_on(upper: Mapping[str, Any], lower: Mapping[str, Any]) -> float:
    """The probability that a box rests on another one: its middle over it, its foot on its top."""
    away = upper["pose"][:3, 3] - lower["pose"][:3, 3]
    deviations = _deviations(np.eye(3), upper, lower)
    height = half_height(upper) + half_height(lower)
    reach = 0.5 * float(min(lower["size"]))
    sides = [_within(float(away[axis]), reach, deviations[axis]) for axis in (0, 1)]
    return math.prod(sides) * _within(float(away[2]) - height, GAP_M, deviations[2])


def chance_on_table(body: Mapping[str, Any]) -> float:
    """The probability that a box rests on the table, z = 0."""
    height = float(body["pose"][2, 3]) - half_height(body)
    return _within(height, GAP_M, _deviations(np.eye(3), body)[2])


def _deviations(axes: Floats, *bodies: Mapping[str, Any]) -> Floats:
    """(3,) standard deviations of where bodies are beside one another, along the rows of axes, m."""
    variance = np.full(3, MODEL_M**2)
    for body in bodies:
        rotation = axes @ body["pose"][:3, :3]
        variance = variance + np.diag(rotation @ body["covariance"][:3, :3] @ rotation.T)
    return np.asarray(np.sqrt(variance))


def _within(mean: float, reach: float, deviation: float) -> float:
    """How likely a normal variable is within a reach of 0."""
    scale = 1.0 / (deviation * math.sqrt(2.0))
    return 0.5 * (math.erf((reach - mean) * scale) + math.erf((reach + mean) * scale))
