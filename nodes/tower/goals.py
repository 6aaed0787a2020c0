"""What towers are asked for, as data: lists of cubes from the bottom up, or sets of cubes in whatever order."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations
from typing import Any, TypeAlias

from hierax.nodes.picking.layout import check_cubes

Tower: TypeAlias = "tuple[int, ...] | frozenset[int]"
"""Ids of cubes from the bottom up; or of those of which it is to be built, in any order."""

Towers: TypeAlias = "tuple[Tower, ...]"


def read_towers(given: Any, cubes: int) -> Towers:
    """The towers that are asked for.

    Args: given: one tower, as ``[3, 1, 4]``, or several, as ``[[3, 1], [4, 2]]``; ids of cubes, from the bottom up.
        One may be a set, ``{2, 5}``: these cubes, in any order. cubes: how many there are, with ids from 1.
    Raises ValueError: it is none, a cube is not there, or is asked for twice; or no scene has so many cubes."""
    check_cubes(cubes)
    several = given if _is_list(given) and given and all(map(_is_tower, given)) else [given]
    towers = tuple(_read_tower(tower) for tower in several)
    if not all(towers) or not towers:
        raise ValueError(f"tower is {given!r}; expected ids of cubes from the bottom up, such as [3, 1, 4]")
    seen: set[int] = set()
    for cube in (cube for tower in towers for cube in tower):
        if type(cube) is not int or not 1 <= cube <= cubes:
            raise ValueError(f"tower is {given!r}: there is no cube {cube!r}; expected ids from 1 to {cubes}")
        if cube in seen:
            raise ValueError(f"tower is {given!r}: cube {cube} is asked for twice")
        seen.add(cube)
    return towers


def orders_of(tower: Tower) -> Iterator[tuple[int, ...]]:
    """In what orders a tower may be built, from the bottom up."""
    return iter((tower,)) if isinstance(tower, tuple) else permutations(sorted(tower))


def _read_tower(given: Any) -> Any:
    """A tower, of cubes that may be none."""
    if isinstance(given, Mapping) and all(value is None for value in given.values()):
        return frozenset(map(_number, given))
    return tuple(given) if _is_list(given) else (given,)


def _number(key: Any) -> Any:
    return int(key) if isinstance(key, str) and key.isascii() and key.isdigit() else key


def _is_tower(value: Any) -> bool:
    return _is_list(value) or isinstance(value, Mapping)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)
