"""Values, and the finite sets of them that nodes exchange."""

from typing import Any

Value = Any  # a value as `hierax.schemas.values` describes it; never mutated

Elements = tuple[Value, ...]  # a set of the theory (observations, actions, task parameters, context), in a fixed order
