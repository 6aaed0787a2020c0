"""The rules by which a tower grows: teleo-reactive (Nilsson, JAIR 1994), nested as in the literature on blocks.

They are gone through again in every epoch, from what holds now: whatever somebody does to a tower, the first rule that
fits brings it nearer to what is wanted. A wish is a cube, and what it is to be moved onto: a cube, or `TABLE`."""

from typing import NamedTuple

from hierax.nodes.tower.goals import Tower, Towers, orders_of
from hierax.nodes.tower.symbols import Symbols

TABLE = 0

Step = tuple[int, int]
"""A move: a cube, and what it comes onto."""


class Plan(NamedTuple):
    """Moves that are to follow, and what each cube is on when the first of them begins, pairs; empty: there is none."""

    plan: tuple[Step, ...]
    expects: tuple[Step, ...]


NO_PLAN = Plan((), ())


class Wish(NamedTuple):
    """What is to be done, and by which rule; the cube None: nothing."""

    rule: str
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
            return _make(order, symbols)
    return Wish("done") if symbols.holding is None else Wish("put away", symbols.holding)


def _make(tower: tuple[int, ...], symbols: Symbols) -> Wish:
    """makeTower: the cubes that stand as they should stay; the next one comes onto them."""
    height = height_of(tower, symbols)
    base = tower[height - 1] if height else TABLE
    wanted = tower[height] if height < len(tower) else None
    if symbols.holding is not None:
        fits = symbols.holding == wanted and (base == TABLE or symbols.is_clear(base))
        return Wish("place", symbols.holding, base) if fits else Wish("put away", symbols.holding)
    if base != TABLE and not symbols.is_clear(base):
        return Wish("unpile the tower", symbols.above(base)[-1])
    if wanted is None:
        return Wish("done")
    if wanted in symbols.unknown:
        return Wish("look for the next cube")
    if not symbols.is_clear(wanted):
        return Wish("unpile the next cube", symbols.above(wanted)[-1])
    return Wish("move to the tower" if base != TABLE else "move to the table", wanted, base)
