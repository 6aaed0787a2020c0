from __future__ import annotations

import math
from collections.abc import Mapping
from mmap import mmap
from typing import Any

import pytest

from hierax.runtime.execution.pace import Pace
from hierax.runtime.transport.node_answers import is_answer
from hierax.runtime.watch.budget import Budget
from hierax.runtime.watch.meter import Meter
from hierax.runtime.watch.overruns import OVERRUNS_BYTES, Overruns
from hierax.schemas.roster import Reference, Roster
from hierax.schemas.values import decode_value, encode_value

METER: Mapping[str, Any] = {
    "process": "a",
    "pid": 7,
    "epoch": 3,
    "busy": "",
    "waits_for": [["low", "obs"]],
    "rss_bytes": 1 << 20,
    "cpu_s": 0.5,
    "metrics": {"error": math.nan},
    "meter": Meter().read(),
}
STATE: Mapping[str, Any] = {
    "process": "a",
    "epoch": 3,
    "committed": None,
    "class": "toys:Arm",
    "below": ["low"],
    "above": [],
    "policy": "still",
    "policies": ["move", "still"],
    "actions": (),
    "belief": {"any": b"thing"},
}
STEP: Mapping[str, Any] = {
    **STATE,
    "attempt": 0,
    "time_s": 0.1,
    "sensed": None,
    "observations": (),
    "tasks": (),
    "context": (),
    "before": None,
}
ROSTER = Roster("world", {"world": Reference("a:B", {})}, ()).plain()


def kept_times() -> dict[str, Any]:
    """What a process tells that is held to times."""
    overruns = Overruns(lambda: None, False, 10.0, mmap(-1, OVERRUNS_BYTES))
    assert overruns._number("top") == 0
    pace = Pace(100.0, "skip")
    for epoch in range(1, 6):
        pace.ended()
        pace.begin(epoch)
    return {"pace": pace.told(), "budget": Budget(2.0, None, lambda: None).told(), "overruns": overruns.told()}


@pytest.mark.parametrize(
    ("look", "answer"),
    [
        ("meter", METER),
        ("meter", {**METER, "in_force": {"top": 3}, "timing": {}}),
        ("meter", {**METER, "timing": kept_times()}),
        ("state", STATE),
        ("state", {**STEP, "committed": True}),
        ("state", {"process": "a", "epoch": 0, "refusal": "still coming"}),
        ("neighbours", {"below": ["low"], "above": []}),
        ("echo", {"lease_s": 5.0}),
        ("steps", {"lease_s": 5.0, "roster": None}),
        ("roster", {"roster": ROSTER}),
    ],
)
def test_what_nodes_say(look: str, answer: Mapping[str, Any]) -> None:
    assert is_answer(look, decode_value(encode_value(dict(answer))))


@pytest.mark.parametrize(
    ("look", "answer"),
    [
        *((look, {"process": "a"}) for look in ("meter", "state", "neighbours", "steps", "roster")),
        *(
            ("meter", {name: each for name, each in METER.items() if name != left})
            for left in METER
            if left != "process"
        ),
        ("meter", {"process": "a", "refusal": "no"}),
        ("meter", {**METER, "pid": True}),
        ("meter", {**METER, "cpu_s": math.nan}),
        ("meter", {**METER, "cpu_s": 1e300}),
        ("meter", {**METER, "rss_bytes": "much"}),
        ("meter", {**METER, "waits_for": [["low"]]}),
        ("meter", {**METER, "metrics": {"error": "large"}}),
        ("meter", {**METER, "meter": {**METER["meter"], "work_ns": 3}}),
        ("meter", {**METER, "meter": {**METER["meter"], "waiting_ns": {"low": 0.5}}}),
        ("meter", {**METER, "meter": {**METER["meter"], "epochs_ns": [None]}}),
        ("meter", {**METER, "in_force": {"\x1b[2J": 3}}),
        ("meter", {**METER, "timing": 3}),
        ("meter", {**METER, "timing": {"pace": {}}}),
        ("meter", {**METER, "timing": {"pace": {**kept_times()["pace"], "more": b"bytes"}}}),
        ("meter", {**METER, "timing": {"budget": {"over": 1}}}),
        ("meter", {**METER, "timing": {"overruns": {"top": 3}}}),
        *(
            ("state", {name: each for name, each in STATE.items() if name != left})
            for left in STATE
            if left != "process"
        ),
        *(
            ("state", {name: each for name, each in STEP.items() if name != left})
            for left in STEP.keys() - STATE.keys() - {"sensed"}
        ),
        ("state", {**STATE, "committed": "yes"}),
        ("state", {**STATE, "committed": [1]}),
        ("state", {**STATE, "below": 5}),
        ("state", {**STATE, "policies": [5]}),
        ("state", {"refusal": 5}),
        ("state", {**STEP, "observations": 5}),
        ("neighbours", {"below": 5}),
        ("neighbours", {"below": [5]}),
        ("neighbours", {"below": ["\x1b[2J"]}),
        ("steps", {"roster": 5}),
        ("roster", {"roster": {**ROSTER, "nodes": 5}}),
    ],
)
def test_what_has_another_shape(look: str, answer: Mapping[str, Any]) -> None:
    assert not is_answer(look, decode_value(encode_value(dict(answer))))
