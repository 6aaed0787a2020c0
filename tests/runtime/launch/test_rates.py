"""Launches whose world has a rate: on time, late, and changed by `hierax set`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from support.launched import Launched, hierax, run_here, said_here, until

DEPLOYMENT = """
hierarchy: paced
world: world
epochs: 150
nodes:
  world: {class: "support.rate_nodes:Ticks", rate_hz: 100}
  slow: {class: "support.rate_nodes:Sometimes", parameters: {every: 50, took_ms: 35.0}, budget_ms: 20}
  quick: {class: "support.rate_nodes:Counts"}
edges:
  world -> slow: {sense: "support.rate_nodes:seen"}
  world -> quick: {sense: "support.rate_nodes:seen"}
"""


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "paced.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return str(path)


def test_late_epochs_are_named_with_the_node_and_nothing_drifts(file: str) -> None:
    report = hierax("launch", file)
    timing, wanted = report["timing"], run_here(file)
    assert report["digest"] == wanted["digest"], "a rate changes nothing but when"
    assert timing["budgets"]["slow"]["over"] == 3
    assert timing["budgets"]["slow"]["max_ms"] >= 35.0
    assert timing["rate"]["after"]["slow"] >= 3
    assert timing["rate"]["late"] >= timing["rate"]["after"]["slow"]
    assert report["wall_s"] >= 1.48, "the last of 150 epochs begins 1.48 s after the second"


def test_a_rate_is_for_the_world_alone_with_the_barrier(file: str) -> None:
    said = said_here("run", file, "--set", "nodes.slow.rate_hz=5")
    assert said.returncode == 1
    assert (
        "nodes.slow.rate_hz: nodes have rates only in free running (staleness: null), the world also with"
        in said.stderr
    )


def test_parameters_of_a_node_are_set_while_it_runs(file: str, tmp_path: Path) -> None:
    def said(*arguments: str) -> subprocess.CompletedProcess[str]:
        return said_here(*arguments, folder=tmp_path)

    def told(*arguments: str) -> Any:
        done = said(*arguments, "--format", "json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    with Launched(tmp_path, file, "--epochs", "1000000"):
        told("ps", "--wait", "5")
        for text, why in [
            ("slow.took_ms=long", "nodes.slow.parameters.took_ms: expected a number, got 'long'"),
            ("slow.took=1", "has no such parameter; did you mean 'took_ms'?"),
            ("slo.took_ms=1", "there is no node 'slo' in paced"),
            ("slow.took_ms=1 slow.took_ms=2", "expected each parameter once, got took_ms, took_ms"),
            ("took_ms=1", "expected NODE.PARAMETER=VALUE, got 'took_ms=1'"),
        ]:
            done = said("set", *text.split())
            code = 2 if " each " in why or "NODE." in why else 1
            assert (done.returncode, why in done.stderr) == (code, True), done
        assert told("inspect", "slow")["roster"] == 0, "nothing has changed"
        epoch = told("set", "slow.took_ms=0.5", "slow.every=7")["epoch"]
        assert epoch > 5
        assert told("inspect", "slow")["belief"] >= epoch - 1, "it has kept what it had counted"
        timing = told("top", "--once", "--interval", "0.2")["timing"]
        assert timing["rate"]["period_ms"] == 10.0
        assert timing["budgets"]["slow"]["budget_ms"] == 20.0


def test_what_is_attached_has_the_budget_and_processors_that_its_snippet_says(file: str, tmp_path: Path) -> None:
    cpu = min(os.sched_getaffinity(0))
    (tmp_path / "more.yaml").write_text(
        "nodes:\n"
        f'  more: {{class: "support.rate_nodes:Counts", budget_ms: 17, scheduling: {{cpus: [{cpu}]}}}}\n'
        'edges:\n  world -> more: {sense: "support.rate_nodes:seen"}\n',
        encoding="utf-8",
    )
    with Launched(tmp_path, file, "--epochs", "1000000") as launch:
        until(lambda: launch.epoch >= 5, "five epochs")
        done = said_here("attach", str(tmp_path / "more.yaml"), folder=tmp_path)
        assert done.returncode == 0, done.stderr
        told = said_here("top", "--once", "--interval", "0.2", "--format", "json", folder=tmp_path)
        budgets = json.loads(told.stdout)["timing"]["budgets"]
        (run,) = json.loads(said_here("ps", "--format", "json", folder=tmp_path).stdout)["runs"]
        pid = run["nodes"]["more"]["pid"]
        kept_to = [os.sched_getaffinity(int(task)) for task in os.listdir(f"/proc/{pid}/task")]
    assert (budgets["more"]["budget_ms"], budgets["quick"]["budget_ms"]) == (17.0, 10.0)
    assert {cpu} in kept_to


def test_who_waits_for_a_process_that_was_killed_was_not_at_work(file: str, tmp_path: Path) -> None:
    budgets = [("world", 200), ("quick", 200), ("slow", 200)]
    settings = [f"nodes.{name}.budget_ms={budget}" for name, budget in budgets]
    settings += ["nodes.slow.parameters.every=1", "nodes.slow.parameters.took_ms=8.0"]
    with Launched(tmp_path, file, *(word for each in settings for word in ("--set", each))) as launch:
        until(lambda: launch.epoch >= 10, "ten epochs")
        launch.kill("slow")
        report = json.loads(launch.end())
    assert "slow: its process is lost" in launch.err
    assert {name: report["timing"]["budgets"][name]["over"] for name in ("world", "quick")} == {"world": 0, "quick": 0}


def test_what_a_world_that_was_killed_had_counted_is_told(file: str, tmp_path: Path) -> None:
    """In the summary all epochs and their times are the run's, and so are those of a run that is resumed."""
    settings = ["nodes.slow.parameters.every=10", "restart.restart_delay=0"]
    words = [word for each in settings for word in ("--set", each)]
    begun_s = time.monotonic()
    with Launched(tmp_path, file, *words, "--epochs", "400") as launch:
        for epoch in (60, 120):
            until(lambda least=epoch: launch.epoch >= least, f"{epoch} epochs")
            launch.kill("world")
        until(lambda: launch.epoch >= 170, "170 epochs")
        launch.process.send_signal(signal.SIGINT)
        broken = json.loads(launch.end())
    lasted_s = time.monotonic() - begun_s
    time.sleep(1.0)  # a pause, which counts for nothing
    begun_s = time.monotonic()
    with Launched(tmp_path, "--resume", str(tmp_path / "state")) as launch:
        report = json.loads(launch.end())
    lasted_s += time.monotonic() - begun_s
    assert report["epochs"] == 400
    assert 1.6 <= broken["wall_s"] < report["wall_s"] < lasted_s
    assert report["wall_s"] - broken["wall_s"] >= 0.01 * (400 - broken["epochs"] - 3)
    assert report["timing"]["rate"]["late"] > broken["timing"]["rate"]["late"] >= 30


def test_the_backlog_of_a_world_that_stood_still_has_a_line(file: str, tmp_path: Path) -> None:
    with Launched(tmp_path, file, "--set", "nodes.slow.parameters.took_ms=0", "--epochs", "1000") as launch:
        until(lambda: launch.epoch >= 30, "thirty epochs")
        pid = launch.until_pid("world")
        os.kill(pid, signal.SIGSTOP)
        time.sleep(1.5)
        os.kill(pid, signal.SIGCONT)
        launch.until_said("epochs late, which follow at once")
        until(lambda: launch.epoch >= 200, "what is overdue")
        launch.end()


def test_a_nodes_counts_go_on_after_a_kill_and_with_other_parameters(file: str, tmp_path: Path) -> None:
    """Late epochs are put down to whoever was over the budget then."""

    def over() -> int:
        told = said_here("top", "--once", "--interval", "0.1", "--format", "json", folder=tmp_path)
        timing = json.loads(told.stdout).get("timing", {}) if told.returncode == 0 else {}
        return int(timing.get("budgets", {}).get("slow", {"over": 0})["over"])  # who comes back does not answer yet

    settings = ["--set", "nodes.slow.parameters.every=10", "--epochs", "1000000"]
    with Launched(tmp_path, file, *settings) as launch:
        until(lambda: over() >= 3, "a budget that is broken")
        launch.kill("slow")
        until(lambda: over() >= 6, "counts that go on")
        before = over()
        assert said_here("set", "slow.every=1000000", folder=tmp_path).returncode == 0
        until(lambda at=launch.epoch: launch.epoch >= at + 20, "epochs")
        launch.process.send_signal(signal.SIGINT)
        timing = json.loads(launch.end())["timing"]
    assert timing["budgets"]["slow"]["over"] >= before
    assert timing["rate"]["after"]["slow"] >= before
