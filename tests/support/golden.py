"""What the golden files hold. Run as a script to write files that are missing; it never changes one that is there.

A file that is there must decode to the JSON beside it, and encode to the same bytes, for ever.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hierax.schemas.control import (
    AskStatus,
    CatchUp,
    CaughtUp,
    Census,
    Control,
    Dismiss,
    Failed,
    Fetch,
    HandOver,
    Join,
    Lost,
    Prepare,
    Propose,
    Ready,
    Resend,
    State,
    Status,
    Taken,
    TakeOver,
    Unchanged,
)
from hierax.schemas.messages import CONTEXT, HELLO, OBSERVATIONS, TASKS, Header, Message, decode_message, encode_message
from hierax.schemas.rates import Began, Rates, Timing, Turns
from hierax.schemas.roster import Reference, Roster, RosterEdge
from hierax.schemas.values import decode_value, encode_value
from support.tagged import tagged

FOLDER = Path(__file__).parents[1] / "golden"

_DTYPES = ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8", "<c8", "<c16")
_EDGES = {
    "none": None,
    "yes": True,
    "no": False,
    "ints": [0, -1, 127, 128, -128, 65536, (1 << 63) - 1, -(1 << 63), (1 << 64) - 1],
    "floats": [0.0, -0.0, 0.1, 1e308, float("inf"), float("-inf"), float("nan")],
    "texts": ["", "belief", "Perzeption ü 知覚 🦅"],
    "bytes": [b"", b"\x00\xff", bytes(range(256))],
    "nested": {"empty": {}, "order": {"b": 1, "a": 2}, "rows": [[], [[1.5]], ()]},
}
_REFERENCE = Reference("package.module:Camera", {"focal_px": 525.8, "size": [640, 480]})
_ROSTER = Roster(
    world="world",
    nodes={"world": Reference("package.module:World"), "arm": _REFERENCE},
    edges=(RosterEdge("world", "arm", sense=Reference("package.module:seen"), context=_REFERENCE),),
)

_RATES = Rates(
    {"arm": Turns(5, 2)},
    {("world", "arm"): 3},
    frozenset({("world", "arm")}),
    Timing({"arm": 7}, {("world", "arm"): Began(7, 2, False)}, frozenset({"arm"}), {("world", "arm"): None}),
)
_RATED = _ROSTER.with_rates(_RATES)

MESSAGES = {
    "minimal": Message(Header(OBSERVATIONS, "world", "arm", 1), ()),
    "header": Message(
        Header(
            kind=CONTEXT,
            sender="spatial",
            receiver="arm.left_2",
            epoch=218,
            attempt=3,
            roster=7,
            instance=(1 << 64) - 1,
            time_s=10.85,
            digest=bytes(range(32)),
            extensions={"trace": b"\x01\x02", "zz-unknown": {"deep": [1, None, np.arange(3.0)]}, "a-unknown": -1},
        ),
        ("context",),
    ),
    "values": Message(Header(TASKS, "arm", "world", 2, time_s=0.05), (_EDGES, "second", 3)),
    "small-arrays": Message(
        Header(OBSERVATIONS, "world", "arm", 3),
        (
            {code: np.arange(6).reshape(2, 3).astype(code) for code in _DTYPES},
            np.float64(0.25),
            np.array(1.5, "<f4"),
            np.zeros((0, 4), "<u2"),
            np.asfortranarray(np.arange(6, dtype=">i4").reshape(2, 3)),
        ),
    ),
    "large-arrays": Message(
        Header(CONTEXT, "spatial", "arm", 4, digest=bytes(32), extensions={"mask": np.arange(17000) % 3 == 0}),
        (
            {"depth": np.linspace(0.2, 2.0, 80 * 60, dtype="<f4").reshape(60, 80), "near": 0.2},
            np.arange(5, dtype="<i2"),
            np.arange(16384 // 8, dtype="<f8"),
        ),
    ),
    "hello": Message(Header(HELLO, "arm", "spatial", 0, instance=2), ()),
}

CONTROL: tuple[Control, ...] = (
    Prepare(_ROSTER.plain(), ("arm",), ("arm",)),
    Unchanged(3, 2),
    HandOver(3, 217, 1),
    TakeOver(3, 217, 1, b"\x00state", b"\x00said"),
    AskStatus(5),
    Resend(218, 0, ("arm", "spatial")),
    CatchUp(218),
    Dismiss("another process runs it", again=True),
    Join("arm", "b7e1", "", 217, True, "", 3, 1),
    Ready("arm", "b7e1", 3, "no such class ü"),
    State("arm", 3, b"\x00state", b"\x00said"),
    Taken("arm", 3, ""),
    Fetch("arm", "b7e1", 3),
    CaughtUp("arm", "b7e1", 218),
    Status("arm", 5, 218, 0, (("world", OBSERVATIONS), ("spatial", CONTEXT)), "observe of arm", 3),
    Failed("arm", "b7e1", 3, "arm", "observe in epoch 218: out of luck"),
    Lost("arm", "b7e1", True),
    Census({"arm": "b7e1", "world": "c001"}),
    Propose("q1", {"change": "detach", "name": "arm"}, {"arm": "detach"}, {"arm": 1.5}, ("arm",)),
)
"""One of each kind."""

VALUES = {
    "control": tuple((type(word).__name__, *word) for word in CONTROL),
    "state": ({"pose": np.eye(4), "lost": False}, "follow", (0.5, {"grip": np.array([1, 0], bool)})),
    "large-in-place": {"image": (np.arange(200 * 100) % 251).astype(np.uint8).reshape(200, 100)},
    "roster-content": _ROSTER.content(),
    "roster": _ROSTER.plain(),
    "roster-rates": _RATED.plain(),
}


def encoded() -> dict[str, bytes]:
    """All cases as bytes, by file name."""
    return {
        **{f"message-{name}.msgpack": encode_message(message) for name, message in MESSAGES.items()},
        **{f"value-{name}.msgpack": encode_value(value) for name, value in VALUES.items()},
    }


def decoded(path: Path) -> Any:
    """What hierax reads in a golden file."""
    data = path.read_bytes()
    return decode_message(data) if path.name.startswith("message-") else decode_value(data)


def plain(value: Any) -> Any:
    """A decoded file as the JSON beside it has it; a message with its header's fields by name."""
    if isinstance(value, Message):
        return {"header": tagged(value.header._asdict()), "payload": tagged(value.payload)}
    return tagged(value)


def write_missing() -> None:
    """Write the golden files that are not there."""
    FOLDER.mkdir(exist_ok=True)
    for name, data in encoded().items():
        path = FOLDER / name
        if not path.exists():
            path.write_bytes(data)
            path.with_suffix(".json").write_text(json.dumps(plain(decoded(path)), indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write_missing()
