"""Keys and the names in them."""

from __future__ import annotations

import pytest

from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys, check_name

KEYS = Keys("tracking", "run-1")


def test_keys_are_the_documented_ones() -> None:
    assert KEYS.edge("obs", "world", "arm") == "hierax/tracking/run-1/obs/world/arm"
    assert KEYS.inbox("arm") == "hierax/tracking/run-1/*/*/arm"
    assert KEYS.alive("arm", 3) == "hierax/tracking/run-1/alive/arm/3"
    assert KEYS.alive("arm") == "hierax/tracking/run-1/alive/arm/*"
    assert KEYS.control("arm") == "hierax/tracking/run-1/control/arm"
    assert KEYS.epochs == "hierax/tracking/run-1/epochs"


@pytest.mark.parametrize("name", ["a", "N0", "arm.left_2-b", "9", "x" * 128])
def test_names(name: str) -> None:
    assert check_name(name) == name


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "-a", "_a", "a/b", "a b", "a*", "$*", "a->b", "ä", "a\n", "x" * 129, "x" * 10**6, 1, None, b"a"],
)
def test_what_is_no_name(name: object) -> None:
    with pytest.raises(SchemaError, match=r"is no node's name: expected at most 128 letters") as raised:
        check_name(name, "node's name")  # type: ignore[arg-type]
    assert len(str(raised.value)) < 200
