"""Whether what a deployment gives as a parameter is of the type that the code's annotation says.

Annotations of true or false, whole numbers, numbers and texts are looked at, each or None;
others, and those that cannot be resolved, are the code's own business."""

import inspect
import math
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

from hierax.schemas.values import Value

_EXPECTED: dict[Any, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


def wrong_argument(target: Callable[..., Any], parameters: Mapping[str, Value]) -> tuple[str, str] | None:
    """The first parameter of another type than a class or function says, and what was expected; None: none is."""
    try:
        known = inspect.signature(target, eval_str=True).parameters
    except (NameError, TypeError, ValueError, AttributeError, SyntaxError):
        return None
    for name, value in parameters.items():
        allowed = _allowed(known[name].annotation) if name in known else ()
        if allowed and not any(_is_of(value, kind) for kind in allowed):
            expected = " or ".join("null" if kind is type(None) else _EXPECTED[kind] for kind in allowed)
            return name, f"expected {expected}, got {in_words(value)}"
        if float in allowed and isinstance(value, float) and math.isnan(value):
            return name, "expected a number, got .nan"
    return None


def _allowed(annotation: Any) -> tuple[Any, ...]:
    """The types that a value may have; empty: any."""
    is_union = typing.get_origin(annotation) in (typing.Union, types.UnionType)
    kinds = typing.get_args(annotation) if is_union else (annotation,)
    return kinds if all(_is_looked_at(kind) or (is_union and kind is type(None)) for kind in kinds) else ()


def _is_looked_at(kind: Any) -> bool:
    return any(kind is each for each in _EXPECTED)  # an annotation may be anything, also what has no hash


def _is_of(value: Value, kind: Any) -> bool:
    if kind in (int, float):
        return isinstance(value, (int, kind)) and not isinstance(value, bool)
    return isinstance(value, kind)


def in_words(value: Value) -> str:
    """A value as errors show one that is of the wrong kind."""
    if isinstance(value, (dict, list, tuple)):
        return "a map" if isinstance(value, dict) else "a list"
    if isinstance(value, bool):
        return "true" if value else "false"
    return "null" if value is None else "bytes" if isinstance(value, bytes) else f"{value!r:.60}"
