"""Keys and the names in them."""

from __future__ import annotations

import pytest

from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys, check_name, check_process, living, node_of, process_token

KEYS = Keys("tracking", "run-1")


def test_keys_are_the_documented_ones() -> None:
    assert KEYS.edge("obs", "world", "arm") == "hierax/tracking/run-1/obs/world/arm"
    assert KEYS.inbox("arm") == "hierax/tracking/run-1/*/*/arm"
    assert KEYS.alive("arm", 3) == "hierax/tracking/run-1/alive/arm/3"
    assert KEYS.alive("arm") == "hierax/tracking/run-1/alive/arm/*"
    assert KEYS.control("arm~3f") == "hierax/tracking/run-1/control/arm~3f"
    assert KEYS.words("arm") == "hierax/tracking/run-1/words/arm"
    assert KEYS.launch == "hierax/tracking/run-1/launch"
    assert KEYS.changes == "hierax/tracking/run-1/changes"
    assert KEYS.epochs == "hierax/tracking/run-1/epochs"


def test_a_process_is_known_to_be_a_nodes_by_its_token() -> None:
    token = process_token("arm.left", "3f")
    assert check_process(token) == token == "arm.left~3f"
    assert node_of(token) == "arm.left"
    assert check_process("3f") == "3f"
    for wrong in ("arm~", "~3f", "arm~3~f", "arm~*", "a/b", 3):
        with pytest.raises(SchemaError, match="is no process: expected at most 128 letters"):
            check_process(wrong)  # type: ignore[arg-type]


def test_a_sign_of_life_is_that_of_the_node_s_own_process() -> None:
    assert living(KEYS.alive("arm", "arm~3f")) == ("arm", "arm~3f")
    for name, token in (("arm", "left~3f"), ("arm", "3f"), ("arm", "arm~*"), ("*", "arm~3f"), ("arm", "*"), ("*", "*")):
        assert living(KEYS.alive(name, token)) is None, (name, token)


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
