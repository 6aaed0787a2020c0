"""Launches whose nodes take part now and then: the digests are those of `run`, whatever dies."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from support.launched import Launched, run_here, said_here, until
from support.mixing_nodes import ALONE, BESIDE, written
from support.partitions import outcome_of

NODES = ("world", "quick", "middle", "slow", "side")
PACED = ("--set", "nodes.world.rate_hz=200", "--set", "restart.restart_delay=0.0")


@pytest.fixture
def file(tmp_path: Path) -> str:
    return str(written(tmp_path))


def beliefs(report: dict[str, Any]) -> dict[str, Any]:
    return {name: node["belief"] for name, node in report["nodes"].items()}


def check_as_run(report: dict[str, Any], file: str, *words: str) -> None:
    """The digest, and what every node believes at the end, also one that the world did not wait for."""
    wanted = run_here(file, *words)
    assert (report["epochs"], report["digest"]) == (wanted["epochs"], wanted["digest"])
    assert beliefs(report) == beliefs(wanted)


def test_every_node_killed_once_changes_nothing(tmp_path: Path, file: str) -> None:
    with Launched(tmp_path, file, "--epochs", "500", *PACED) as launch:
        for number, name in enumerate((*NODES, "slow", "world")):
            launch.until_epoch(launch.epoch + 20 if number else 30)
            launch.kill(name)
        report = launch.report()
        assert all(f"{name}: its process ended by signal SIGKILL" in launch.err for name in NODES)
    check_as_run(report, file, "--epochs", "500")


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_any_hierarchy_with_rates_is_launched_as_it_is_run(seed: int) -> None:
    """In random processes, of which one is killed."""
    outcome = outcome_of(seed, rated=True)
    assert not outcome.fault, f"seed {seed}"


def test_two_neighbours_killed_at_once_change_nothing(tmp_path: Path, file: str) -> None:
    with Launched(tmp_path, file, "--epochs", "300", *PACED) as launch:
        for pair in (("middle", "slow"), ("world", "slow"), ("quick", "middle")):
            launch.until_epoch(launch.epoch + 30)
            for name in pair:
                launch.kill(name)
        report = launch.report()
    check_as_run(report, file, "--epochs", "300")


def test_epochs_go_on_without_who_is_lost_for_as_long_as_its_delays_last(tmp_path: Path, file: str) -> None:
    late = ("--set", "nodes.world.rate_hz=100", "--set", "restart.restart_delay=3.0")
    with Launched(tmp_path, file, "--epochs", "100", *late) as launch:
        launch.kill("slow")  # its first restart is at once
        launch.until_epoch(20)
        until(lambda: launch.epoch % 20 in (8, 9, 10), "a turn of slow that is just over")
        launch.kill("slow")
        killed = launch.epoch
        launch.until_epoch(killed + 8)
        assert not launch.pid("slow"), "it comes back after 3 s"
        report = launch.report()
    check_as_run(report, file, "--epochs", "100")


def test_who_is_behind_when_the_world_has_finished_comes_to_the_end(tmp_path: Path, file: str) -> None:
    last = ("--set", "nodes.world.parameters.last=95", "--set", "nodes.slow.parameters.takes_s=0.05")
    with Launched(tmp_path, file, *last) as launch:
        report = launch.report()
    assert report["epochs"] == 95
    check_as_run(report, file, *last)


@pytest.mark.parametrize("victims", [("slow",), ("quick", "slow"), ("world",), ("world", "middle")], ids=" ".join)
def test_who_dies_when_the_world_has_finished_comes_to_the_end(
    tmp_path: Path, file: str, victims: tuple[str, ...]
) -> None:
    last = ("--set", "nodes.world.parameters.last=70", "--set", "nodes.slow.parameters.takes_s=1.5")
    with Launched(tmp_path, file, *last, *PACED) as launch:
        launch.until_epoch(70)  # the turn of slow in epoch 67 counts in none of them, and goes on
        assert launch.running
        for name in victims:
            launch.kill(name)
        report = launch.report()
        assert all(f"{name}: its process ended by signal SIGKILL" in launch.err for name in victims)
    assert report["epochs"] == 70
    check_as_run(report, file, *last)


def test_who_takes_longer_than_its_delay_is_waited_for_and_named(tmp_path: Path, file: str) -> None:
    late = ("--set", "nodes.slow.parameters.takes_s=0.3", "--epochs", "100")
    with Launched(tmp_path, file, *late, *PACED) as launch:
        report = launch.report()
    assert sum(report["timing"]["overruns"]["slow"].values()) >= 1
    budgets = {name: each["budget_ms"] for name, each in report["timing"]["budgets"].items()}
    assert budgets == {"world": 5.0, "quick": 5.0, "middle": 5.0, "slow": 25.0, "side": 5.0}, "its delays are 20 and 5"
    check_as_run(report, file, *late)


def test_what_a_process_that_was_killed_has_waited_for_is_told(tmp_path: Path, file: str) -> None:
    def count() -> int:
        told = said_here("top", "--once", "--interval", "0.1", "--format", "json", folder=tmp_path)
        timing = json.loads(told.stdout).get("timing") if told.returncode == 0 else None
        return int((timing or {}).get("overruns", {}).get("slow", {}).get("middle", 0))

    late = ("--set", "nodes.slow.parameters.takes_s=0.6", "--epochs", "200")  # it has ten turns in them
    with Launched(tmp_path, file, *late, *PACED) as launch:
        until(lambda: count() >= 6, "six overruns")
        launch.kill("middle")
        report = launch.report()
    assert report["timing"]["overruns"]["slow"]["middle"] >= 6, "after the kill there are fewer"
    check_as_run(report, file, *late)


def test_a_run_that_is_broken_off_ends_with_an_epoch_of_all_nodes(tmp_path: Path, file: str) -> None:
    with Launched(tmp_path, file, *PACED) as launch:
        launch.until_epoch(50)
        os.kill(launch.process.pid, signal.SIGINT)
        report = json.loads(launch.end())
        assert launch.process.returncode == 130
    assert report["interrupted"]
    check_as_run(report, file, "--epochs", str(report["epochs"]))


def test_a_run_goes_on_from_its_checkpoints(tmp_path: Path, file: str) -> None:
    with Launched(tmp_path, file, "--epochs", "400", *PACED) as launch:
        launch.until_epoch(60)
        launch.process.kill()
        launch.end()
    with Launched(tmp_path, "--resume", str(tmp_path / "state")) as launch:
        report = launch.report()
    assert report["digest"] == run_here(file, "--epochs", "400")["digest"]


def test_parameters_are_set_and_a_node_is_detached(tmp_path: Path, file: str) -> None:
    snippet = tmp_path / "slow.yaml"
    snippet.write_text('nodes:\n  slow: {class: "support.mixing_nodes:Mixing", parameters: {takes_s: 0.001}}\n')
    epochs = ("--epochs", "300")
    with Launched(tmp_path, file, *epochs, *PACED) as launch:
        launch.until_epoch(1)
        done = [said_here(*words, folder=tmp_path) for words in (["set", "slow.takes_s=0.001"], ["detach", "side"])]
        report = launch.report()
    first = [said.stdout.split()[-1] for said in done]
    at = ("--at", f"{first[0]}:replace:slow:{snippet}", "--at", f"{first[1]}:detach:side")
    check_as_run(report, file, *epochs, *at)


def test_a_world_that_waits_for_nobody_comes_up_and_hears(tmp_path: Path) -> None:
    file, beside, epochs = tmp_path / "alone.yaml", tmp_path / "beside.yaml", ("--epochs", "600")
    file.write_text(ALONE)
    beside.write_text(BESIDE)
    with Launched(tmp_path, str(file), *epochs) as launch:
        launch.until_epoch(5)
        said = said_here("attach", str(beside), folder=tmp_path)
        assert said.returncode == 0, said.stderr
        first = said.stdout.split()[-1]
        assert launch.epoch < 300, "it heard of it before long"
        report = launch.report()
    check_as_run(report, str(file), *epochs, "--at", f"{first}:attach:{beside}")


def test_nodes_thousands_of_epochs_apart_are_as_in_one_process(tmp_path: Path) -> None:
    file = tmp_path / "alone.yaml"
    file.write_text(ALONE)
    slow = ("--set", "nodes.slow.every=2000", "--set", "nodes.world.parameters.takes_s=0", "--epochs", "4500")
    gathering = (*slow, "--set", "edges.world -> slow.gather=true")
    with Launched(tmp_path, str(file), *gathering) as launch:
        check_as_run(launch.report(), str(file), *gathering)
