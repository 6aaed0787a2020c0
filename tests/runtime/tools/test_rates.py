from __future__ import annotations

import json
from typing import Any

import pytest

from hierax.runtime.commands.top import headline, table
from hierax.runtime.tools.rates import doing, overview, rates_between
from hierax.runtime.transport.launch_client import LaunchStatus


def answer(seconds: float, epochs: int, process: str = "a", **change: Any) -> dict[str, Any]:
    """What a node says that has worked for a quarter of the time, and waited for `low` the rest."""
    ns = int(seconds * 1e9)
    work = {"observe": ns // 8, "policy": 0, "predict": ns // 8, "edges": 0, "act": 0, "other": 0}
    return {
        "process": process,
        "pid": 7,
        "epoch": epochs + 1,
        "busy": "",
        "waits_for": [["low", "obs"]],
        "rss_bytes": 1 << 20,
        "metrics": {},
        "cpu_s": seconds / 2,
        "meter": {
            "ns": ns,
            "epochs": epochs,
            "work_ns": work,
            "waiting_ns": {"low": ns // 2, "top": ns // 4},
            "epochs_ns": [1_000_000, 3_000_000],
        },
        **change,
    }


SEEN = LaunchStatus(
    "toys",
    "5163af85",
    9,
    2,
    {
        name: {"process": "a", "pid": 7, "state": "running", "restarts": 1, "instance": 0, "host": ""}
        for name in ("low", "mid")
    },
)


def test_rates_are_of_what_was_done_in_between() -> None:
    rates = rates_between(answer(2, 10), answer(4, 30))
    assert (rates["epochs"], rates["epochs_per_s"], rates["cpu"]) == (20, 10, 0.5)
    assert rates["share"] == {
        "observe": 0.125,
        "policy": 0,
        "predict": 0.125,
        "edges": 0,
        "act": 0,
        "other": 0,
        "waiting": 0.75,
    }
    per_epoch = rates["per_epoch_us"]
    assert (per_epoch["observe"], per_epoch["waiting"]) == (12_500, 75_000)
    assert list(rates["waits_for"].items()) == [("low", pytest.approx(2 / 3)), ("top", pytest.approx(1 / 3))]


@pytest.mark.parametrize("before", [None, answer(2, 10, process="another"), answer(9, 10)])
def test_a_process_that_is_new_counts_from_its_beginning(before: dict[str, Any] | None) -> None:
    rates = rates_between(before, answer(4, 30))
    assert (rates["epochs"], rates["epochs_per_s"], rates["cpu"]) == (30, 7.5, 0.0)


def test_without_an_epoch_there_are_shares_alone() -> None:
    rates = rates_between(answer(2, 10), answer(4, 10))
    assert rates["per_epoch_us"] is None
    assert rates["share"]["waiting"] == 0.75


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"busy": "observe of mid"}, "in observe of mid"),
        ({"waits_for": [["top", "ctx"], ["top", "task"], ["a", "ctx"]]}, "waits for a, top"),
        ({"waits_for": []}, "between epochs"),
    ],
)
def test_what_a_node_does_now(change: dict[str, Any], text: str) -> None:
    assert doing(answer(1, 1, **change)) == text


def test_an_overview_has_all_nodes_also_those_that_are_silent() -> None:
    look = overview(SEEN, {"mid": answer(2, 10)}, {"mid": answer(4, 30)})
    assert (look["epoch"], look["epochs_per_s"], look["epoch_us"]["p50"]) == (30, 10, 2000)
    assert look["nodes"]["low"] == {
        "state": "running",
        "pid": 7,
        "instance": 0,
        "restarts": 1,
        "host": "",
        "answers": False,
    }
    mid = look["nodes"]["mid"]
    assert (mid["answers"], mid["cpu"], mid["rss_bytes"], mid["doing"]) == (True, 0.5, 1 << 20, "waits for low")


def test_with_rates_it_is_told_what_counts_at_a_node() -> None:
    rated = answer(4, 30, in_force={"top": 27, "side": 0})
    look = overview(SEEN, {}, {"mid": rated, "low": answer(4, 30, in_force={})})
    assert look["nodes"]["mid"]["in_force"] == {"top": 27, "side": 0}
    assert "in_force" not in look["nodes"]["low"]
    (column,) = [column for column in table(look).columns if column.header == "with"]
    assert list(map(str, column.cells)) == ["", "side -, top 27"]
    plain = overview(SEEN, {}, {"mid": answer(4, 30)})
    assert "with" not in [column.header for column in table(plain).columns]


def test_an_overview_of_figures_that_are_none_is_plain_json() -> None:
    look = overview(SEEN, {}, {"mid": answer(4, 30, metrics={"error": float("nan"), "far": float("inf")})})
    json.dumps(look, allow_nan=False)
    assert headline(look).endswith("; mid: error nan, far inf")


def test_work_of_which_a_node_says_nothing_is_none() -> None:
    silent = answer(4, 30)
    silent["meter"] = {**silent["meter"], "work_ns": {}}
    assert rates_between(None, silent)["share"] == {
        **dict.fromkeys(("observe", "policy", "predict", "edges", "act", "other"), 0.0),
        "waiting": 0.75,
    }
    assert table(overview(SEEN, {}, {"mid": silent})).row_count == 2


def test_of_several_that_say_they_have_the_worlds_pace_none_counts() -> None:
    pace = {"period_ms": 10.0, "p50_ms": 0.0, "p99_ms": 0.0, "max_ms": 0.0, "late": 0, "skipped": 0, "epochs": []}
    budget = {"budget_ms": 2.0, "over": 1, "max_ms": 3.0, "epochs": []}
    paced, both = answer(4, 30, timing={"pace": pace}), answer(4, 30, timing={"pace": pace, "budget": budget})
    assert "rate" in overview(SEEN, {}, {"mid": paced})["timing"]
    assert overview(SEEN, {}, {"mid": paced, "low": both})["timing"].keys() == {"budgets"}


def test_an_overview_of_nobody() -> None:
    look = overview(SEEN, {}, {})
    assert (look["epoch"], look["epochs_per_s"], look["epoch_us"]) == (9, 0.0, {"p50": None, "p99": None})
