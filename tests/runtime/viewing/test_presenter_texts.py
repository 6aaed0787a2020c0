from __future__ import annotations

import numpy as np

from hierax.runtime.viewing.presenter import MOST_LINES, belief_text, figures_text


def test_a_belief_is_an_outline() -> None:
    belief = {
        "frame": 3,
        "name": "arm",
        "nothing": None,
        "size": (640, 480),
        "pose": np.eye(2) / 3,
        "image": np.zeros((480, 640, 3), np.uint8),
        "raw": b"abc",
        "empty": {},
        "objects": ({"id": 1, "score": 0.123456789}, {"id": 2, "score": 1.0}),
    }
    assert belief_text(belief).splitlines() == [
        "frame: 3",
        "name: arm",
        "nothing: null",
        "size: [640, 480]",
        "pose:",
        "- [0.333333, 0.0]",
        "- [0.0, 0.333333]",
        "image: uint8 480 × 640 × 3",
        "raw: 3 bytes",
        "empty: {}",
        "objects:",
        "- id: 1",
        "  score: 0.123457",
        "- id: 2",
        "  score: 1.0",
    ]


def test_what_is_too_long_is_cut_off_and_says_so() -> None:
    lines = belief_text({str(number): number for number in range(240)}).splitlines()
    assert len(lines) == MOST_LINES + 1
    assert lines[-1] == "… 40 more lines"
    assert belief_text(tuple(range(30))).endswith(", 15, … 14 more]")
    assert len(belief_text("x" * 500)) == 80
    assert belief_text(0.5) == "0.5"


def test_a_few_figures() -> None:
    assert figures_text({"tracked": 6.0, "score": 0.123456}) == "tracked 6\nscore 0.1235"
    assert figures_text({str(number): 1.0 for number in range(9)}).count("\n") == 3
