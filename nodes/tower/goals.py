"""What towers are asked for, as data: lists of cubes from the bottom up."""

from collections.abc import Sequence
from typing import Any

Towers = tuple[tuple[int, ...], ...]


def read_towers(given: Any, cubes: int) -> Towers:
    """The towers that are asked for.

    Args: given: one tower, as ``[3, 1, 4]``, or several, as ``[[3, 1], [4, 2]]``; ids of cubes, from the bottom up.
        cubes: how many there are, with ids from 1.
    Raises ValueError: it is none, a cube is not there, or is asked for twice."""
    several = given if _is_list(given) and given and all(map(_is_list, given)) else [given]
    towers = tuple(tuple(tower) if _is_list(tower) else (tower,) for tower in several)
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


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)
