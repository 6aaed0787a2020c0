"""The rules: in a world of blocks that does what is wished, and that somebody else changes, every tower is built."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, seed
from hypothesis import strategies as st

from hierax.nodes.tower.goals import orders_of
from hierax.nodes.tower.rules import LOOKED_FOR, Wish, height_of, is_done, wish_of
from hierax.nodes.tower.symbols import NOTHING, Symbols
from hierax.nodes.tracking.schema import TABLE

CUBES = (1, 2, 3, 4, 5)
Blocks = dict[int, int]
"""Of each cube, what it stands on."""


def symbols_of(blocks: Blocks, holding: int | None = None, unknown: tuple[int, ...] = ()) -> Symbols:
    on = tuple(sorted((upper, lower) for upper, lower in blocks.items() if lower != TABLE and upper != holding))
    table = tuple(sorted(cube for cube, lower in blocks.items() if lower == TABLE and cube != holding))
    return Symbols(on, table, unknown, holding, {})


def done(blocks: Blocks, wish: Wish) -> Blocks:
    """What becomes of the blocks; the wish has to be possible."""
    assert wish.cube is not None
    assert wish.cube not in blocks.values(), f"something stands on {wish.cube}"
    assert wish.onto == TABLE or wish.onto not in blocks.values(), f"something stands on {wish.onto}"
    return {**blocks, wish.cube: wish.onto}


def laid_out(rng: random.Random) -> Blocks:
    """Cubes at random, each on the table or on one that is clear."""
    blocks: Blocks = {}
    for cube in rng.sample(CUBES, len(CUBES)):
        free = [TABLE, *(other for other in blocks if other not in blocks.values())]
        blocks[cube] = rng.choice(free)
    return blocks


@seed(1)
@given(st.integers(0, 2**32), st.integers(1, 5))
def test_every_tower_is_built_in_few_moves(number: int, height: int) -> None:
    rng = random.Random(number)
    blocks = laid_out(rng)
    tower = tuple(rng.sample(CUBES, height))
    moves = 0
    while not is_done(tower, symbols_of(blocks)):
        blocks = done(blocks, wish_of((tower,), symbols_of(blocks)))
        moves += 1
        assert moves <= 2 * len(CUBES), (number, tower, blocks)
    assert wish_of((tower,), symbols_of(blocks)) == Wish("done")


@seed(1)
@given(st.integers(0, 2**32))
def test_whoever_changes_the_blocks_it_is_built_in_the_end(number: int) -> None:
    rng = random.Random(number)
    blocks, towers = laid_out(rng), ((1, 2), (4, 3, 5))
    for move in range(60):
        if move < 20 and rng.random() < 0.4:
            blocks = laid_out(rng)
        wish = wish_of(towers, symbols_of(blocks))
        if wish.cube is None:
            break
        blocks = done(blocks, wish)
    assert all(is_done(tower, symbols_of(blocks)) for tower in towers), (number, blocks)


@seed(1)
@given(st.integers(0, 2**32), st.integers(1, 5))
def test_of_cubes_in_any_order_one_is_built(number: int, height: int) -> None:
    rng = random.Random(number)
    blocks, tower = laid_out(rng), frozenset(rng.sample(CUBES, height))
    stood = max(height_of(order, symbols_of(blocks)) for order in orders_of(tower))
    onto_it = 0
    while not is_done(tower, symbols_of(blocks)):
        wish = wish_of((tower,), symbols_of(blocks))
        assert wish.cube is not None
        held = symbols_of(blocks, holding=wish.cube)
        then = wish_of((tower,), held)
        placed = then.rule.endswith(" > place") and then[1:] == wish[1:]
        assert placed or wish.onto == TABLE, (number, then)
        blocks = done(blocks, wish)
        onto_it += wish.onto != TABLE
        assert onto_it <= height - stood, (number, tower, blocks)


TOWER, ON_1, ON_TABLE = "make tower 1 2 > ", "move 2 onto 1 > ", "move 1 onto the table > "


@pytest.mark.parametrize(
    ("symbols", "wish"),
    [
        (symbols_of({1: 0, 2: 0, 3: 0}, holding=2), Wish(f"{TOWER}{ON_1}place", 2, 1)),
        (symbols_of({1: 0, 2: 0, 3: 0}, holding=3), Wish(f"{TOWER}{ON_1}put away", 3)),
        (symbols_of({1: 0, 2: 0, 3: 1}, holding=2), Wish(f"{TOWER}{ON_1}put away", 2)),
        (symbols_of({1: 0, 2: 0, 3: 1}), Wish(f"{TOWER}{ON_1}clear 1 > move 3 onto the table > take", 3)),
        (symbols_of({1: 0, 3: 0}, unknown=(2,)), Wish(f"{TOWER}{ON_1}look", 2, LOOKED_FOR)),
        (symbols_of({1: 0, 2: 1, 3: 2}), Wish(f"{TOWER}clear 2 > move 3 onto the table > take", 3)),
        (symbols_of({1: 0, 2: 0, 3: 2}), Wish(f"{TOWER}{ON_1}clear 2 > move 3 onto the table > take", 3)),
        (symbols_of({1: 3, 2: 0, 3: 0}), Wish(f"{TOWER}make tower 1 > {ON_TABLE}take", 1)),
        (symbols_of({1: 0, 2: 1, 3: 0}, holding=3), Wish("put away", 3)),
        (symbols_of({1: 0, 2: 1, 4: 2, 3: 4}), Wish(f"{TOWER}clear 2 > move 3 onto the table > take", 3)),
        (Symbols(((1, 2), (2, 1)), (), (), None, {}), Wish(f"{TOWER}make tower 1 > {ON_TABLE}clear 1 > look")),
        (Symbols(((3, 1), (4, 3), (3, 4)), (1, 2), (), None, {}), Wish(f"{TOWER}{ON_1}clear 1 > look")),
        (NOTHING, Wish(f"{TOWER}make tower 1 > {ON_TABLE}take", 1)),
    ],
)
def test_the_first_rule_that_fits(symbols: Symbols, wish: Wish) -> None:
    assert wish_of(((1, 2),), symbols) == wish
