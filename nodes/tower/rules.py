"""The rules by which a tower grows: teleo-reactive (Nilsson, JAIR 1994), nested as in the literature on blocks.

They are gone through again in every epoch, from what holds now: whatever somebody does to a tower, the first rule that
fits brings it nearer to what is wanted. A rule is a wish, or a program of rules itself. A wish is a cube, and what it
is to be moved onto: a cube, or `TABLE`; or `LOOKED_FOR`: it is looked for."""

from typing import NamedTuple

from hierax.nodes.tower.goals import Tower, Towers, orders_of
from hierax.nodes.tower.symbols import Symbols
from hierax.nodes.tracking.schema import TABLE

LOOKED_FOR = -2  # in the place of what a cube comes onto: it is not moved, but looked for

Step = tuple[int, int]
"""A move: a cube, and what it comes onto; or a look for it."""


class Plan(NamedTuple):
    """Moves that are to follow, and what each cube is on when the first of them begins, pairs; empty: there is none."""

    plan: tuple[Step, ...]
    expects: tuple[Step, ...]


NO_PLAN = Plan((), ())


class Wish(NamedTuple):
    """What is to be done; the cube None: nothing."""

    rule: str  # by which one, within which programs, the outermost first, as in ``make tower 1 3 > clear 1 > take``
    cube: int | None = None
    onto: int = TABLE


def height_of(tower: tuple[int, ...], symbols: Symbols) -> int:
    """How many cubes of a tower, from the bottom, stand as they should."""
    below = symbols.below
    height = 0
    for level, cube in enumerate(tower):
        stands = cube in symbols.on_table if level == 0 else below.get(cube) == tower[level - 1]
        if not stands:
            break
        height += 1
    return height


def is_done(tower: Tower, symbols: Symbols) -> bool:
    """Whether a tower stands, with nothing on it."""
    return _stands(order_of(tower, symbols), symbols)


def _stands(order: tuple[int, ...], symbols: Symbols) -> bool:
    return height_of(order, symbols) == len(order) and symbols.is_clear(order[-1])


def order_of(tower: Tower, symbols: Symbols) -> tuple[int, ...]:
    """In which order a tower is built of what is there: where any will do, that of which most stands already and least
    has to be taken away, the first of those that are alike."""
    return min(orders_of(tower), key=lambda order: _left(order, symbols))


def _left(order: tuple[int, ...], symbols: Symbols) -> tuple[int, bool, int]:
    """What is to be done for a tower: cubes that come onto it; whether the next of them is not at hand; and how many
    are in the way."""
    height = height_of(order, symbols)
    stands, coming = order[:height], order[height:]
    in_the_way = {above for cube in (*stands[-1:], *coming) for above in symbols.above(cube)} - set(stands)
    away = bool(coming) and (coming[0] in symbols.unknown or symbols.holding not in (None, coming[0]))
    return len(coming), away, len(in_the_way)


def wish_of(towers: Towers, symbols: Symbols) -> Wish:
    """What the first rule that fits asks for."""
    for tower in towers:
        order = order_of(tower, symbols)
        if not _stands(order, symbols):
            return _make_tower(order, symbols)
    return Wish("done") if symbols.holding is None else Wish("put away", symbols.holding)


def _make_tower(tower: tuple[int, ...], symbols: Symbols) -> Wish:
    """makeTower: what stands as it should is set free; on what stands the highest cube is moved, on all but which a
    tower is made first."""
    *lower, top = tower
    if height_of(tower, symbols) == len(tower):
        then = _make_clear(top, symbols)
    elif height_of(tuple(lower), symbols) == len(lower):
        then = _move(top, lower[-1] if lower else TABLE, symbols)
    else:
        then = _make_tower(tuple(lower), symbols)
    return _in(f"make tower {' '.join(map(str, tower))}", then)


def _make_clear(cube: int, symbols: Symbols) -> Wish:
    """unpile: the highest of what stands on a cube comes onto the table. Where each of two is held to be on the other,
    that is looked at until it is otherwise."""
    highest = symbols.above(cube)[-1]
    then = _move(highest, TABLE, symbols) if symbols.is_clear(highest) else Wish("look")
    return _in(f"clear {cube}", then)


def _move(cube: int, onto: int, symbols: Symbols) -> Wish:
    """moveToBlock and moveToTable: what is in the hand comes first, then what is in the way."""
    is_clear = onto == TABLE or symbols.is_clear(onto)
    if symbols.holding is not None:
        fits = symbols.holding == cube and is_clear
        then = Wish("place", cube, onto) if fits else Wish("put away", symbols.holding)
    elif not is_clear:
        then = _make_clear(onto, symbols)
    elif cube in symbols.unknown:
        then = Wish("look", cube, LOOKED_FOR)
    elif not symbols.is_clear(cube):
        then = _make_clear(cube, symbols)
    else:
        then = Wish("take", cube, onto)
    return _in(f"move {cube} onto {onto or 'the table'}", then)


def _in(program: str, then: Wish) -> Wish:
    return then._replace(rule=f"{program} > {then.rule}")
