from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from support.live import Live

from hierax.runtime.commands.inspect import as_json
from hierax.runtime.commands.main import main
from hierax.runtime.transport.launch_client import LaunchStatus

SEEN = LaunchStatus("toys", "aa", 3, 0, {})


def test_a_node_as_json_says_what_it_believes_and_why(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "low", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["hierarchy"], told["node"], told["below"], told["above"]) == ("live", "low", ["world"], ["high"])
    assert told["class"] == "hierax.runtime.sim.nodes:Drawer"
    assert told["epoch"] > 0
    assert told["policy"] in told["policies"]
    assert {"observations", "sensed", "tasks", "context", "actions", "belief", "committed"} <= told.keys()
    assert "process" not in told


def test_it_is_what_the_run_in_one_process_has_in_that_epoch(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "high", "--format", "json", "--full"]) == 0
    told = json.loads(capsys.readouterr().out)
    (live.folder / "stop").unlink(missing_ok=True)
    node = live.repeated(told["epoch"])["nodes"]["high"]
    assert {key: told[key] for key in ("belief", "policy", "actions")} == {
        key: node[key] for key in ("belief", "policy", "actions")
    }


def test_a_node_as_text(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "world"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"world of live, run {live.run['run']}: after epoch ")
    assert lines[2:4] == ["below  nothing", "above  low"]
    assert any(line.startswith("belief") for line in lines)


def test_a_node_that_there_is_not(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "hihg"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"error: there is no node 'hihg' in live, run {live.run['run']}; did you mean 'high'?\n"


@pytest.mark.parametrize(("full", "shown"), [(True, list), (False, dict)])
def test_arrays_are_summarised_unless_all_is_wanted(full: bool, shown: type) -> None:
    answer: dict[str, Any] = {"process": "a", "belief": np.zeros(100)}
    told = as_json(SEEN, "arm", answer, full)
    assert isinstance(told["belief"], shown)
    json.dumps(told, allow_nan=False)
