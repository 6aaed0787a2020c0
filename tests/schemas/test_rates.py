"""What rates say of the time that nodes have."""

from __future__ import annotations

from typing import Any

import pytest

from hierax.schemas.errors import SchemaError
from hierax.schemas.rates import Began, EdgeRates, Rates, Timing, Turns
from hierax.schemas.values import decode_value, encode_value

PAIRS = (("w", "a"), ("w", "b"), ("a", "c"), ("b", "c"), ("c", "d"))


@pytest.mark.parametrize(
    ("every", "a_c", "b_c", "expected"),
    [(1, 0, 0, 1), (60, 60, 60, 60), (60, 60, 20, 20), (20, 60, 60, 20), (60, 0, 60, 1), (60, 60, 0, 1), (1, 5, 5, 1)],
)
def test_a_node_has_the_least_of_its_turns_and_delays(every: int, a_c: int, b_c: int, expected: int) -> None:
    said = {("a", "c"): a_c, ("b", "c"): b_c}
    rates = Rates({"c": Turns(every)}, {pair: delay for pair, delay in said.items() if delay}, pairs=PAIRS)
    assert rates.epochs_for("c") == expected
    assert rates.epochs_for("w") == rates.epochs_for("a") == 1


def test_an_epoch_is_held_up_by_who_is_joined_to_the_world_without_delay() -> None:
    assert Rates(pairs=PAIRS).awaited(3) == set("wabcd")
    assert Rates(delays={("a", "c"): 1}, pairs=PAIRS).awaited(3) == set("wabcd"), "b waits for c"
    assert Rates(delays={("a", "c"): 1, ("b", "c"): 1}, pairs=PAIRS).awaited(3) == set("wab"), "nor for who is above c"
    assert Rates(delays={("w", "a"): 1, ("b", "c"): 1}, pairs=PAIRS).awaited(3) == set("wb"), "nobody waits for a"
    turns = {"b": Turns(2), "c": Turns(3)}
    delays = {("a", "c"): 1}
    assert Rates(turns, delays, pairs=PAIRS).awaited(3) == set("wa"), "b takes no part"
    assert Rates(turns, delays, pairs=PAIRS).awaited(6) == set("wabcd")


TIMING = Timing(
    {"a": 3},
    {("w", "a"): Began(3, 1, False)},
    frozenset(("b", "c")),
    {("w", "b"): None, ("b", "c"): EdgeRates(2, 1, 1)},
)


def test_a_timing_comes_back() -> None:
    assert Timing.read(TIMING.plain(), "timing") == TIMING
    assert Timing.read(decode_value(encode_value(TIMING.plain())), "timing") == TIMING


@pytest.mark.parametrize("value", [None, 0, 7, True, "bc", [7], [["w", "a"]]])
@pytest.mark.parametrize("name", ["since", "began", "fresh", "changed"])
def test_what_is_no_field_of_a_timing_is_refused_by_name(name: str, value: Any) -> None:
    plain: Any = TIMING.plain()
    for part in (value, decode_value(encode_value(value))):
        with pytest.raises(SchemaError) as raised:
            Timing.read({**plain, name: part}, "timing")
        assert raised.value.where == f"timing.{name}"
