"""Messages over named hypotheses: what beliefs and letters' observations are made of.

A message is a dict from hypothesis to a number that counts only up to a common factor; here all of them sum to 1. 0
means impossible, exactly: products keep their exponents apart, and what would underflow stays at `TINY`, so that later
evidence can still choose it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence

from hierax.runtime.core.errors import HieraxError

Weights = Mapping[str, float]

TINY = sys.float_info.min  # the least number other than 0 in a message


class ImpossibleEvidenceError(HieraxError):
    """Every hypothesis has probability 0: there is nothing to normalise."""


def uniform(names: Sequence[str]) -> dict[str, float]:
    """The message that tells nothing."""
    return {name: 1.0 / len(names) for name in names}


def is_number(value: object) -> bool:
    """Whether a parameter is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def weights(names: Sequence[str], values: Sequence[float], what: str) -> dict[str, float]:
    """Numbers that a user gave as a parameter, one of 0 or more for each hypothesis and not all 0, as a message. Raises
    ValueError: they are none."""
    expected = f"{what}: expected {len(names)} numbers, for {', '.join(names)}"
    if isinstance(values, (str, bytes)) or not isinstance(values, Sequence) or len(values) != len(names):
        raise ValueError(f"{expected}; got {values!r}")
    for value in values:
        if not is_number(value) or value < 0:
            raise ValueError(f"{expected}, each finite and at least 0; got {value!r}")
    if not any(values):
        raise ValueError(f"{expected}, at least one of them more than 0; got {list(values)}")
    return normalised(dict(zip(names, values, strict=True)), what)


def normalised(message: Weights, what: str) -> dict[str, float]:
    """The message scaled to sum 1. Raises ImpossibleEvidenceError: all is 0; `what` says of which message."""
    top = max(message.values())
    if not top > 0:
        raise ImpossibleEvidenceError(f"{what}: the evidence is impossible, nothing is left of {', '.join(message)}")
    scaled = {name: value / top for name, value in message.items()}
    total = math.fsum(scaled.values())
    return {name: max(scaled[name] / total, TINY) if value > 0 else 0.0 for name, value in message.items()}


def product(names: Sequence[str], factors: Iterable[Weights], what: str) -> dict[str, float]:
    """The normalised element-wise product of messages; of none, the uniform one. Raises ImpossibleEvidenceError: the
    product is 0 everywhere."""
    factors = tuple(factors)
    parts = {name: _extended_product(factor[name] for factor in factors) for name in names}
    top = max((exponent for fraction, exponent in parts.values() if fraction > 0), default=0)
    message = {
        name: max(math.ldexp(fraction, exponent - top), TINY) if fraction > 0 else 0.0
        for name, (fraction, exponent) in parts.items()
    }
    return normalised(message, what)


def _extended_product(values: Iterable[float]) -> tuple[float, int]:
    """The product as (fraction, exponent of 2), which cannot underflow."""
    fraction, exponent = 1.0, 0
    for value in values:
        part, part_exponent = math.frexp(value)
        fraction, shift = math.frexp(fraction * part)
        exponent += part_exponent + shift
    return fraction, exponent
