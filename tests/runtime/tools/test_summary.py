from __future__ import annotations

import numpy as np
import pytest

from hierax.runtime.tools.summary import SHOWN_ITEMS, in_line, tree
from hierax.schemas.values import Value

MOVES = "\x1b]0;owned\x07\x1b[2J\nx"


@pytest.mark.parametrize(
    "value",
    [
        np.full(40, np.nan),
        np.array([1.0, np.inf] * 20),
        np.zeros((0, 5)),
        np.ones(40, bool),
        np.ones(40, complex) * 1j,
        {"a": (1, (float("nan"), b"\x01" * 100, b"ab", None))},
        np.float32(2.5),
    ],
)
def test_whatever_there_is_becomes_text(value: Value) -> None:
    assert "\n".join(tree(value, "value"))


def test_short_values_take_a_line_and_long_ones_a_tree() -> None:
    assert list(tree({"x": 1.23456789, "name": "arm"}, "belief")) == ["belief  {x: 1.23457, name: 'arm'}"]
    lines = list(tree({"pose": (1.0,) * 30, "image": np.zeros((480, 640, 3), np.uint8)}, "belief"))
    assert lines[0] == "belief"
    assert lines[1] == "  pose  [" + ", ".join(["1"] * 30) + "]"
    assert lines[2] == "  image  uint8 480×640×3, 0 to 0, mean 0"


@pytest.mark.parametrize("most", [None, 3])
@pytest.mark.parametrize("value", [MOVES, {MOVES: 1}, [{"a": {MOVES: MOVES}}], {MOVES: "x" * 200}])
def test_nothing_moves_the_cursor_or_begins_another_line(value: Value, most: int | None) -> None:
    for line in (in_line(value, most), *tree(value, MOVES), *tree(value)):
        assert line.isprintable()
        assert r"\x1b]0;owned\x07\x1b[2J\nx" in line or "xxx" in line


def test_long_lists_are_cut() -> None:
    lines = list(tree(["x" * 50] * (SHOWN_ITEMS + 5), "all"))
    assert len(lines) == SHOWN_ITEMS + 2
    assert lines[-1] == "  … 5 more"


def test_bytes_show_how_they_begin() -> None:
    assert in_line(b"\x01\x02") == "2 bytes 0102"
    assert in_line(bytes(100)) == f"100 bytes {'00' * 16}…"
