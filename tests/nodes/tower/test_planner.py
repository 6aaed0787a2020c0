"""Plans: the shortest ones, followed as long as cubes are where they are expected, and else made again."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hierax.nodes.tower.builder import Builder, TeleoReactive, builder
from hierax.nodes.tower.doing import DOING, DONE, FAILED
from hierax.nodes.tower.planner import HAND, UNKNOWN, UNSETTLED, Blocks, OpenLoop, Planner, planned
from hierax.nodes.tower.rules import LOOKED_FOR, Step
from hierax.nodes.tower.symbols import Symbols
from hierax.nodes.tracking.math.geometry import make_pose
from hierax.nodes.tracking.schema import TABLE

CUBES = 4
SETTINGS = settings(deadline=None, derandomize=True)


def laid_out(rng: random.Random) -> Blocks:
    """Cubes at random, each on the table or on one that is clear; now and then one in the hand, or unknown."""
    blocks: Blocks = {}
    for cube in rng.sample(range(1, CUBES + 1), CUBES):
        free = [TABLE, *(other for other in blocks if other not in blocks.values())]
        blocks[cube] = rng.choice(free)
    clear = [cube for cube in blocks if cube not in blocks.values()]
    if rng.random() < 0.3:
        blocks[rng.choice(clear)] = rng.choice((HAND, UNKNOWN))
    return blocks


def after(blocks: Blocks, step: Step) -> Blocks:
    """What becomes of the blocks; the step has to be possible."""
    cube, onto = step
    if onto == LOOKED_FOR:
        assert blocks[cube] == UNKNOWN
        return {**blocks, cube: TABLE}
    assert blocks[cube] != UNKNOWN
    assert HAND not in blocks.values() or blocks[cube] == HAND
    assert cube not in blocks.values(), f"something is on {cube}"
    assert onto == TABLE or (onto not in blocks.values() and blocks[onto] != UNKNOWN), f"something is on {onto}"
    return {**blocks, cube: onto}


def stands(blocks: Blocks, order: tuple[int, ...]) -> bool:
    """Whether a tower stands in this order, with nothing on it."""
    lower = (TABLE, *order)
    return all(blocks[cube] == lower[at] for at, cube in enumerate(order)) and order[-1] not in blocks.values()


def shortest(blocks: Blocks, orders: list[tuple[int, ...]]) -> int:
    """How many steps it takes at least, by trying all of them."""
    ways, length = [blocks], 0
    seen = {tuple(sorted(blocks.items()))}
    while not any(stands(way, order) for way in ways for order in orders):
        following = []
        for way in ways:
            for cube in way:
                for onto in (TABLE, LOOKED_FOR, *way):
                    try:
                        reached = (
                            after(way, (cube, onto)) if onto not in (cube, way[cube]) or onto == LOOKED_FOR else way
                        )
                    except AssertionError:
                        continue
                    key = tuple(sorted(reached.items()))
                    if key not in seen:
                        seen.add(key)
                        following.append(reached)
        ways, length = following, length + 1
    return length


@SETTINGS
@given(st.integers(0, 2**32), st.integers(1, CUBES), st.booleans())
def test_a_plan_builds_the_tower_in_the_fewest_steps(number: int, height: int, free: bool) -> None:
    rng = random.Random(number)
    blocks, tower = laid_out(rng), tuple(rng.sample(range(1, CUBES + 1), height))
    plan = planned((frozenset(tower) if free else tower,), blocks)
    assert plan is not None
    orders = list(permutations(tower)) if free else [tower]
    assert len(plan) == shortest(blocks, orders), (number, blocks, tower, plan)
    for step in plan:
        blocks = after(blocks, step)
    assert any(stands(blocks, order) for order in orders), (number, plan)


def test_what_is_in_the_way_comes_onto_the_table_rather_than_onto_a_cube() -> None:
    last = ((3, 1), (4, 3), (2, 4))
    assert planned(((1, 3, 4, 2),), {3: TABLE, 1: TABLE, 4: 3, 2: 4}) == ((2, TABLE), (4, TABLE), *last)
    assert planned(((1, 3, 4, 2),), {1: TABLE, 4: 1, 2: TABLE, 3: HAND}) == ((3, TABLE), (4, TABLE), *last)


IDLE = {"skill": "look", "cube": None, "onto": None, "status": "doing", "looks": True}


def seen(blocks: Blocks, skill: Mapping[str, Any] = IDLE, **doubts: int) -> dict[str, Any]:
    """Arguments of `decided`, but for the belief."""
    on = tuple(sorted((cube, lower) for cube, lower in blocks.items() if lower > 0))
    table = tuple(cube for cube, lower in blocks.items() if lower == TABLE)
    unknown = tuple(cube for cube, lower in blocks.items() if lower == UNKNOWN)
    holding = next((cube for cube, lower in blocks.items() if lower == HAND), None)
    symbols = Symbols(on, table, unknown, holding, {}, (), doubts)
    return {"symbols": symbols, "skill": {**skill, "holding": holding}}


class Played:
    """A builder that is shown one scene after the other."""

    def __init__(self, node: Builder) -> None:
        self.node, self.belief = node, node.initial_belief()

    def sees(self, blocks: Blocks, step: Step | None = None, status: str = DOING, **doubts: int) -> tuple[Any, ...]:
        """The rule, and what is wished for, while a step is done."""
        cube, onto = step or (None, None)
        given = seen(blocks, {**IDLE, "cube": cube, "onto": onto, "status": status}, **doubts)
        wish, plan = self.node.decided(**given, belief=self.belief)
        self.belief = {**self.belief, **wish._asdict(), **plan._asdict()}
        return tuple(wish)


FLAT = {1: TABLE, 2: TABLE, 3: TABLE}


def test_a_plan_is_followed_while_what_it_moves_is_on_its_way() -> None:
    played = Played(Planner([1, 2, 3], 3))
    assert played.sees({**FLAT, 3: -3}, doubts=3)[0] == "look"
    assert played.sees(FLAT) == ("planned", 2, 1)
    assert played.sees({**FLAT, 2: HAND}) == ("as planned", 2, 1)
    assert played.sees({1: TABLE, 3: TABLE}) == ("as planned", 2, 1)
    assert played.sees({**FLAT, 2: 1}) == ("as planned", 3, 2)
    assert played.sees({**FLAT, 2: 1, 3: 2}) == ("done", None, TABLE)
    assert played.sees({**FLAT, 2: 1, 3: 2}) == ("done", None, TABLE)


def test_nothing_is_planned_of_what_nobody_has_seen() -> None:
    """Before the first cube is seen on something there are no doubts, either."""
    for node in (Planner([1, 2, 3], 3), OpenLoop([1, 2, 3], 3)):
        played = Played(node)
        assert played.sees(dict.fromkeys(FLAT, UNSETTLED)) == ("look", None, TABLE)
        assert played.sees({1: TABLE, 2: 1, 3: TABLE}) == ("planned", 3, 2)


@pytest.mark.parametrize("node", [Planner, OpenLoop])
@pytest.mark.parametrize("done", [False, True])
def test_a_plan_for_other_towers_or_cubes_is_made_again(node: Callable[..., Builder], done: bool) -> None:
    """Also of a builder that was done, and where its last step is under way."""
    four = {**FLAT, 4: TABLE}
    before = Played(node([1, 3], 4))
    assert before.sees(four) == ("planned", 3, 1)
    blocks = {**four, 3: 1} if done else four
    if done:
        assert before.sees(blocks, (3, 1), DONE)[0] == "done"
    for tower, cubes, wanted in (([4, 3], 4, (3, 4)), ([1, 3, 5], 5, (5, 3) if done else (3, 1))):
        after_it = Played(node(tower, cubes))
        after_it.belief = before.belief
        assert after_it.sees({**blocks, **({5: TABLE} if cubes == 5 else {})}) == ("planned", *wanted)


def test_what_somebody_else_changes_is_planned_again() -> None:
    played = Played(Planner([1, 2, 3], 3))
    played.sees(FLAT)
    assert played.sees({**FLAT, 3: 1}) == ("planned again", 3, TABLE)
    assert played.sees({**FLAT, 2: 1, 3: 2}) == ("done", None, TABLE)
    assert played.sees({**FLAT, 2: 1, 3: UNKNOWN}) == ("planned again", 3, LOOKED_FOR)
    assert played.sees({**FLAT, 2: 1}) == ("as planned", 3, 2)
    assert played.sees({**FLAT, 1: HAND}) == ("planned again", 1, TABLE)


def test_open_loop_goes_by_what_the_hand_says_alone() -> None:
    played = Played(OpenLoop([1, 2, 3], 3))
    assert played.sees(FLAT)[1:] == (2, 1)
    assert played.sees({**FLAT, 1: 3})[1:] == (2, 1)
    assert played.sees(FLAT, (2, 1), DONE)[1:] == (3, 2)
    assert played.sees(FLAT, (2, 1), DONE)[1:] == (3, 2)
    assert played.sees(FLAT, (3, 2), FAILED)[0] == "done"


def test_what_is_not_settled_is_planned_with_once() -> None:
    """A cube that leans on another one, say: as long as it does, the plan holds."""
    leans = {**FLAT, 4: UNSETTLED}
    played = Played(Planner([1, 2, 3], 4))
    assert played.sees(leans) == ("planned", 2, 1)
    assert [played.sees(leans)[0] for _ in range(3)] == ["as planned"] * 3
    assert played.sees({**leans, 2: 1}) == ("as planned", 3, 2)
    assert played.sees({**leans, 2: UNSETTLED, 3: TABLE})[1:] == (2, 1), "what was put there is there no more"


def test_what_is_found_is_taken_though_it_leans() -> None:
    played = Played(Planner([1, 2, 3], 3))
    assert played.sees({**FLAT, 2: 1, 3: UNKNOWN}) == ("planned", 3, LOOKED_FOR)
    assert played.sees({**FLAT, 2: 1, 3: UNSETTLED}, (3, LOOKED_FOR), DOING) == ("as planned", 3, LOOKED_FOR)
    assert played.sees({**FLAT, 2: 1, 3: UNSETTLED}, (3, LOOKED_FOR), DONE) == ("as planned", 3, 2)


def test_of_what_cannot_be_nothing_is_planned() -> None:
    assert planned(((1, 2),), {1: 2, 2: 1}) is None
    for free in ({1: 2, 2: 1, 3: TABLE}, {1: TABLE, 2: 1, 3: 1}):
        assert planned((frozenset({1, 2, 3}),), free) is None, free
    played = Played(Planner([1, 2], 2))
    assert played.sees({1: 2, 2: 1}) == ("look", None, TABLE)
    assert played.sees({1: TABLE, 2: TABLE}) == ("planned", 2, 1)


def item(number: int) -> dict[str, Any]:
    """A cube on the table."""
    pose = make_pose(np.eye(3), np.array([0.4 + 0.1 * number, 0.0, 0.025]))
    return {"id": number, "pose": pose, "size": np.full(3, 0.05), "covariance": 1e-6 * np.eye(6), "status": "tracked"}


def test_builders_take_one_another_s_place() -> None:
    """With a belief of another one, each goes on with what holds."""
    reactive, planner = Played(TeleoReactive([1, 2, 3], 3)), Played(Planner([1, 2, 3], 3))
    reactive.sees(FLAT)
    planner.belief = reactive.belief
    assert planner.sees({**FLAT, 2: HAND})[1:] == (2, 1)
    reactive.belief = planner.belief
    assert reactive.sees({**FLAT, 2: 1})[1:] == (3, 2)
    assert reactive.belief["plan"] == ()
    hand = {"hand": {"gripper": np.eye(4), "width": 0.08}, "carried": ()}
    told = reactive.node.observe((item(1), item(2), item(3), hand, {"skill": seen(FLAT)["skill"]}), reactive.belief)
    assert told["symbols"]["certainty"]
    assert planner.node.take_over(told) == told
    symbols = told["symbols"]
    wrong_symbols = ({}, 3, None, {**symbols, "on": 3}, {**symbols, "certainty": 1}, {**symbols, "more": ()})
    for wrong in ({}, {**told, "rule": 1}, 3, *({**told, "symbols": each} for each in wrong_symbols)):
        with pytest.raises(ValueError, match="belief"):
            planner.node.take_over(wrong)


def test_builders_by_name() -> None:
    assert type(builder("planner", [1, 2], 2)) is Planner
    with pytest.raises(ValueError, match="builder is 'x'; expected one of reactive, planner, open_loop"):
        builder("x", [1], 2)
