"""Where two values differ; and whether operators leave alone what they are given."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from hierax.runtime.core.binding import Call
from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import OperatorError
from hierax.schemas.errors import SchemaError
from hierax.schemas.values import decode_value, encode_value

ABSENT = "(absent)"  # stands for a value on the side where there is none

EVERY = 256
"""Every how many epochs it is looked at; and in those whose number is a power of two, as most faults show at once. Of a
node with rates, its turns are counted."""


class Unlike(NamedTuple):
    """The first place where two values differ: the field's path, such as ``belief.pose[3]``, and what is there."""

    path: str
    a: Value
    b: Value


def first_unlike(a: Value, b: Value, path: str, tolerance: float = 0.0) -> Unlike | None:
    """The first place where two values differ; None: nowhere.

    Numbers are alike that differ by no more than the tolerance, or by no more than this share of the greater one; 0: to
    the bit. `path` is what the values are called."""
    if tolerance == 0.0 and _encoded(a) == _encoded(b):
        return None
    return next(_walk(a, b, path, tolerance), None)


def difference(expected: Value, got: Value, names: Sequence[str] = (), where: str = "") -> str:
    """The first place where two values differ, and both values there, for an error; empty where they are equal.

    `names`: what the entries of both, which are tuples then, are called."""
    pairs = zip(names, expected, got, strict=True) if names else ((where, expected, got),)
    found = next(filter(None, (first_unlike(one, other, path) for path, one, other in pairs)), None)
    return "" if found is None else f"{found.path.lstrip('. ') or 'value'}: {found.a!r:.60}, then {found.b!r:.60}"


def _walk(a: Value, b: Value, path: str, tolerance: float) -> Iterator[Unlike]:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        yield from _walk_arrays(a, b, path, tolerance)
    elif isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(key for key in b if key not in a)]:
            yield from _walk(a.get(key, ABSENT), b.get(key, ABSENT), f"{path}.{key}", tolerance)
        if list(a) != list(b) and a.keys() == b.keys() and tolerance == 0.0:
            yield Unlike(f"{path} (order of keys)", list(a), list(b))
    elif isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
        for index in range(max(len(a), len(b))):
            left, right = (value[index] if index < len(value) else ABSENT for value in (a, b))
            yield from _walk(left, right, f"{path}[{index}]", tolerance)
    elif not _alike(a, b, tolerance):
        yield Unlike(path, a, b)


def _walk_arrays(a: np.ndarray[Any, Any], b: np.ndarray[Any, Any], path: str, tolerance: float) -> Iterator[Unlike]:
    if a.shape != b.shape or (tolerance == 0.0 and a.dtype != b.dtype):
        yield Unlike(f"{path} (array)", _described(a), _described(b))
        return
    if tolerance and a.dtype.kind in "fciub" and b.dtype.kind in "fciub":
        wide = np.complex128 if "c" in (a.dtype.kind, b.dtype.kind) else np.float64
        different = ~np.isclose(a.astype(wide), b.astype(wide), rtol=tolerance, atol=tolerance, equal_nan=True)
    else:
        different = (_bits(a) != _bits(b)).any(axis=-1)
    places = np.argwhere(different)
    for place in places[:1]:
        at = tuple(int(index) for index in place)
        where = "".join(f"[{index}]" for index in at)
        rest = f" (and {len(places) - 1} more of {a.size})" if len(places) > 1 else ""
        yield Unlike(f"{path}{where}{rest}", a[at].item(), b[at].item())


def _bits(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    flat = np.ascontiguousarray(array).reshape(-1)
    return flat.view(np.uint8).reshape(*array.shape, array.dtype.itemsize)


def _described(array: np.ndarray[Any, Any]) -> str:
    return f"{array.dtype} {'×'.join(map(str, array.shape)) or 'scalar'}"


def _alike(a: Value, b: Value, tolerance: float) -> bool:
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in (a, b))
    if tolerance and numbers:
        return bool(np.isclose(float(a), float(b), rtol=tolerance, atol=tolerance, equal_nan=True))
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return False
    return type(a) is type(b) and _encoded(a) == _encoded(b)


def _encoded(value: Value) -> bytes | str:
    try:
        return encode_value(value)
    except SchemaError:  # ABSENT is a text, and everything else a value; a belief in the middle of an epoch need not be
        return repr(value)


def is_due(epoch: int) -> bool:
    return not (epoch & (EVERY - 1) and epoch & (epoch - 1))


class Vigilance:
    """What the operators of one node are given in one attempt of an epoch, and must not change.

    Looked at in some epochs, as it takes encoding everything again. Arrays are frozen in every epoch: this is about
    lists and dicts, and about belief that was not encoded yet."""

    def __init__(self) -> None:
        self._kept: list[tuple[str, Value, bytes]] = []

    def keep(self, what: str, value: Value) -> None:
        """This is given to operators from now on; what cannot be encoded is told when it is to travel."""
        with suppress(SchemaError):
            self._kept.append((what, value, encode_value(value)))

    def check(self, call: Call, epoch: int) -> None:
        """Look at all of it after a call. Raises `OperatorError` if something is not what it was before."""
        for what, value, before in self._kept:
            if _encoded(value) != before:
                where = difference(decode_value(before), value, (), what)
                told = f"changed the {what} that it was given ({where}); make a copy, or a new value"
                raise OperatorError(call.subject, call.operator, epoch, told)
