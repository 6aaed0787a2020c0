from __future__ import annotations

import pytest

from hierax.runtime.loading.nearest import did_you_mean


@pytest.mark.parametrize(
    ("wrong", "valid", "end"),
    [
        ("nois", ["noise", "gain"], "; did you mean 'noise'?"),
        ("WORLD", ["arm", "world"], "; did you mean 'world'?"),
        ("summer", ["Counter", "Summer"], "; did you mean 'Summer'?"),
        ("x", ["noise", "gain"], "; expected one of gain, noise"),
        ("x", [], ""),
        (
            "zzz",
            [f"name{i}" for i in range(10)],
            "; expected one of " + ", ".join(f"name{i}" for i in range(8)) + " and 2 more",
        ),
    ],
)
def test_the_nearest_name_or_the_valid_ones(wrong: str, valid: list[str], end: str) -> None:
    assert did_you_mean(wrong, valid) == end


def test_the_list_can_be_introduced_otherwise() -> None:
    assert did_you_mean("x", ["arm"], "the nodes are") == "; the nodes are arm"
