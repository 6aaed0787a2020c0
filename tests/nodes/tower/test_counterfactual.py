"""`hierax replay --node builder` with the other builder in its place: what that would have done, epoch by epoch."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.launched import hierax

from hierax.nodes.tower.tasks import task_of
from hierax.nodes.tracking.schema import TABLE

pytest.importorskip("clingo", reason="the extra [plan] is not installed")

RUN = ("run", "tower", "--set", "cubes=2", "--set", "tower=[2, 1]", "--epochs", "40")


@pytest.mark.parametrize(("builder", "other"), [("reactive", "planner"), ("planner", "reactive")])
def test_what_the_other_builder_would_have_done(builder: str, other: str, tmp_path: Path) -> None:
    file = str(tmp_path / "run.mcap")
    hierax(*RUN, "--set", f"builder={builder}", "--record", file, "--exclude", "obs/world/*")
    same = hierax("replay", file, "--node", "builder", "--decisions")["decisions"]["builder"]
    assert (same["epochs"], same["otherwise"]) == (40, 0)
    found = hierax("replay", file, "--node", "builder", "--set", f"builder={other}", "--decisions")["decisions"][
        "builder"
    ]
    assert found["epochs"] == 40
    first, *later = found["stretches"]
    assert first["from"] == 1
    # Before it is settled what is where, rules begin with the lowest cube; no plan is made.
    wishes = {"reactive": [task_of(2, TABLE)], "planner": []}
    assert first["recorded"]["actions"] == wishes[builder]
    assert first["replayed"]["actions"] == wishes[other]
    assert not later, "then both move the upper cube onto the lower one"
    classes = {"planner": "planner:Planner", "reactive": "builder:TeleoReactive"}
    parts = (
        "nodes.builder.class=hierax.nodes.tower." + classes[other],
        "nodes.builder.parameters={tower: [2, 1], cubes: 2}",
    )
    settings = [word for part in parts for word in ("--set", part)]
    by_class = hierax("replay", file, "--node", "builder", *settings, "--decisions")["decisions"]["builder"]
    assert by_class == found
