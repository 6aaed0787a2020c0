"""Symbols from beliefs: which cube is on which, as probabilities of poses with covariances, with hysteresis.

A symbol begins to hold when its probability reaches `BEGINS`, and ends below `ENDS`; in between it is what it was, so
that a pose at the edge does not make it come and go. Either has to be so for `CONFIRMED` epochs in a row, as a pose may
be wrong for an instant. Of cubes that are not seen just now, what held goes on to hold, as nothing speaks against it;
so it does while the hand is among the cubes, as from near poses are wrong for longer than that: then symbols begin
of cubes alone of which none held. Of one that stays lost while the arm looks for it nothing holds but that it is
unknown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tower.placing import half_height
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.schema import LOST, TRACKED

BEGINS, ENDS, CONFIRMED = 0.9, 0.5, 8
PATIENCE = 40  # epochs that the arm looks for a lost cube before what was known of it is given up
GAP_M = 0.008  # so far from touching, what rests on something may seem to be
MODEL_M = 0.001  # standard deviation of what covariances do not tell of: models, and the camera's height

Pair = tuple[int, int]


class Symbols(NamedTuple):
    """What is held to be so; ids of cubes, ascending."""

    on: tuple[Pair, ...]  # (upper, lower)
    on_table: tuple[int, ...]
    unknown: tuple[int, ...]
    holding: int | None  # the cube in the hand
    certainty: Mapping[str, float]  # by symbol, as ``on 3 1``, its probability, of those that are not impossible
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


def symbols_after(before: Symbols, bodies: Sequence[Mapping[str, Any]], holding: int | None, looking: bool) -> Symbols:
    """What holds of the bodies as `hierax.nodes.picking.tracker.scene_known` tells them, after what held before;
    looking: whether the arm does nothing but look."""
    lost = dict(before.lost)
    lost = {body["id"]: lost.get(body["id"], 0) + looking for body in bodies if body["status"] == LOST}
    unknown = sorted(number for number, epochs in lost.items() if epochs >= PATIENCE and number != holding)
    known = [body for body in bodies if body["id"] not in unknown]
    certainty: dict[str, float] = {}
    doubts: dict[str, int] = {}

    def is_held(symbol: str, holds: bool, held: bool, may_change: bool) -> bool:
        if holds != held and may_change:
            doubts[symbol] = before.doubts.get(symbol, 0) + 1
        if doubts.get(symbol, 0) < CONFIRMED:
            return held
        del doubts[symbol]
        return holds

    settled = {*before.below, *before.on_table}
    on: list[Pair] = []
    table: list[int] = []
    for upper in known:
        number = upper["id"]
        if number == holding:
            continue
        may_change = looking or number not in settled
        for lower in known:
            pair = (number, lower["id"])
            if lower is not upper and lower["id"] != holding:
                chance, symbol = chance_on(upper, lower), f"on {pair[0]} {pair[1]}"
                held = pair in before.on
                if is_held(symbol, _holds(chance, held, (upper, lower)), held, may_change):
                    on.append(pair)
                _note(certainty, symbol, chance)
        chance, symbol, held = chance_on_table(upper), f"on_table {number}", number in before.on_table
        if is_held(symbol, _holds(chance, held, (upper,)), held, may_change):
            table.append(number)
        _note(certainty, symbol, chance)
    gone = tuple(sorted(lost.items()))
    return Symbols(tuple(sorted(on)), tuple(sorted(table)), tuple(unknown), holding, certainty, gone, doubts)


def chance_on(upper: Mapping[str, Any], lower: Mapping[str, Any]) -> float:
    """The probability that a box rests on another one: its middle over it, its foot on its top."""
    away = upper["pose"][:3, 3] - lower["pose"][:3, 3]
    deviations = _deviations(upper, lower)
    height = half_height(upper) + half_height(lower)
    reach = 0.5 * float(min(lower["size"]))
    sides = [_within(float(away[axis]), reach, deviations[axis]) for axis in (0, 1)]
    return math.prod(sides) * _within(float(away[2]) - height, GAP_M, deviations[2])


def chance_on_table(body: Mapping[str, Any]) -> float:
    """The probability that a box rests on the table, z = 0."""
    height = float(body["pose"][2, 3]) - half_height(body)
    return _within(height, GAP_M, _deviations(body)[2])


def _deviations(*bodies: Mapping[str, Any]) -> Floats:
    """(3,) standard deviations of where bodies are beside one another, along the world's axes, m."""
    variance = np.full(3, MODEL_M**2)
    for body in bodies:
        rotation = body["pose"][:3, :3]
        variance = variance + np.diag(rotation @ body["covariance"][:3, :3] @ rotation.T)
    return np.asarray(np.sqrt(variance))


def _within(mean: float, reach: float, deviation: float) -> float:
    """How likely a normal variable is within a reach of 0."""
    scale = 1.0 / (deviation * math.sqrt(2.0))
    return 0.5 * (math.erf((reach - mean) * scale) + math.erf((reach + mean) * scale))


def _holds(chance: float, held: bool, bodies: Sequence[Mapping[str, Any]]) -> bool:
    if any(body["status"] != TRACKED for body in bodies):
        return held
    return chance >= (ENDS if held else BEGINS)


def _note(certainty: dict[str, float], symbol: str, chance: float) -> None:
    if chance >= 0.01:
        certainty[symbol] = chance
