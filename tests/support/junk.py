"""Junk in the place of values: what a fuzzer puts into JSON, msgpack and YAML."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from typing import Any

Path = tuple[str | int, ...]

HUGE = (1 << 62, (1 << 64) - 1, -(1 << 63), 10**15)
NUMBERS = (0, 1, -1, 2, 0.0, -0.5, 1e-300, 1e300, float("nan"), float("inf"), float("-inf"), *HUGE)
TEXTS = ("", "a", "\x00", "..", "a/b", "*", "**", "é☃", "x" * 5000, "1", "nan", "os:sep", "no.such:thing")
OTHERS = (None, True, False, b"", b"\x00" * 40, [], {}, [[]], [None], {"a": 1}, {"": None}, [1, "a", None, {}])


def nested(depth: int) -> Any:
    """A list within a list within a list …"""
    value: Any = 0
    for _ in range(depth):
        value = [value]
    return value


def junk(random_: random.Random, old: Any = None) -> Any:
    """Something that is not what was there."""
    kind = random_.randrange(6)
    if kind == 0:
        return random_.choice(NUMBERS)
    if kind == 1:
        return random_.choice(TEXTS)
    if kind == 2:
        return random_.choice(HUGE)
    if kind == 3:
        return nested(random_.choice((3, 60, 70, 200)))
    if kind == 4:
        return _like(random_, old)
    return copy.deepcopy(random_.choice(OTHERS))


def _like(random_: random.Random, old: Any) -> Any:
    """A value of the same type that is another one."""
    if isinstance(old, bool) or old is None:
        return not old
    if isinstance(old, (int, float)):
        return random_.choice((old + 1, old - 1, -old, old * 1000, old + 10**9))
    if isinstance(old, str):
        return random_.choice((old + "x", old[1:], old.upper(), old * 50))
    if isinstance(old, bytes):
        at = random_.randrange(len(old) or 1)
        return random_.choice((old[:at], old + b"\x00", old[:at] + b"\xc1" + old[at + 1 :]))
    if isinstance(old, list):
        return random_.choice((old[1:], old + old[-1:], old[::-1], old * 3))
    if isinstance(old, dict):
        return dict(list(old.items())[1:])
    return 0


def places(value: Any, path: Path = ()) -> Iterator[Path]:
    """The paths of a value and of all that is in it."""
    yield path
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from places(item, (*path, index))


def at(value: Any, path: Path) -> Any:
    """What is at a path."""
    for key in path:
        value = value[key]
    return value


def put(value: Any, path: Path, new: Any) -> Any:
    """A copy with something else at a path."""
    if not path:
        return new
    changed = copy.deepcopy(value)
    at(changed, path[:-1])[path[-1]] = new
    return changed


def without(value: Any, path: Path) -> Any:
    """A copy that lacks what is at a path."""
    changed = copy.deepcopy(value)
    del at(changed, path[:-1])[path[-1]]
    return changed


def mutated(random_: random.Random, value: Any, path: Path | None = None) -> Any:
    """A copy in which one part is junk, lacks, is there twice or has another name.

    Args:
        random_: draws.
        value: of lists and maps.
        path: of the part; None: any.
    """
    where = random_.choice(list(places(value))) if path is None else path
    kind = random_.randrange(8)
    if where and kind == 0:
        return without(value, where)
    if where and kind == 1:
        holder = copy.deepcopy(at(value, where[:-1]))
        if isinstance(holder, dict):
            holder[random_.choice(("x", str(where[-1]) + "2", ""))] = holder.pop(where[-1])
        else:
            holder.insert(where[-1], copy.deepcopy(holder[where[-1]]))
        return put(value, where[:-1], holder)
    return put(value, where, junk(random_, at(value, where)))
