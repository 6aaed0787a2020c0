"""Nodes that share a process: any partition gives the digests of `run`, and nodes come and go as ever."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.launched import Launched, run_here
from support.live import DEPLOYMENT, Live, until
from support.partitions import outcome_of

TOGETHER = DEPLOYMENT.replace("nodes:\n", "processes: {{mind: [low, high]}}\nnodes:\n", 1)


@pytest.fixture
def live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    monkeypatch.setattr("support.live.DEPLOYMENT", TOGETHER)
    launch = Live(tmp_path, pace_s=0.01)
    yield launch
    launch.close()


def pids(live: Live) -> dict[str, int]:
    return {name: node["pid"] for name, node in live.run["nodes"].items()}


@pytest.mark.parametrize("seed", range(8))
def test_any_partition_with_a_kill_gives_the_digest_of_run(seed: int) -> None:
    outcome = outcome_of(seed)
    assert not outcome.fault


@pytest.mark.parametrize("seed", [3, 10, 11])
def test_so_does_a_kill_when_the_last_epoch_is_done(seed: int) -> None:
    outcome = outcome_of(seed, epochs=20, at=20)
    assert not outcome.fault


def test_a_process_that_is_killed_is_one_loss_and_one_restart(live: Live) -> None:
    before = pids(live)
    assert before["low"] == before["high"] != before["world"]
    os.kill(before["low"], signal.SIGKILL)
    until(lambda: pids(live)["high"] not in (None, before["high"]), "another process")
    live.goes_on()
    after = live.run["nodes"]
    assert after["low"]["pid"] == after["high"]["pid"]
    assert [after[name]["restarts"] for name in ("low", "high", "world")] == [1, 1, 0]
    assert len({after[name]["instance"] for name in ("low", "high")}) == 1, "they came back in one version"
    live.is_repeated_by()
    said = [line for line in live.launch.err if "started again" in line]
    assert said == ["hierax: mind (high, low): its process ended by signal SIGKILL; it is started again\n"]


def test_a_node_that_leaves_a_process_leaves_the_others_there(live: Live) -> None:
    before, other = pids(live), live.snippet("high", generation=1)
    schedule = [f"{live.change('replace', 'high', other)}:replace:high:{other}"]
    until(lambda: pids(live)["high"] not in (before["high"], None), "a process of its own")
    assert live.run["nodes"]["high"]["shares"] == ""
    assert pids(live)["low"] == before["low"]
    live.goes_on()
    top = live.snippet("top", "low")
    schedule.append(f"{live.change('attach', top)}:attach:{top}")
    schedule.append(f"{live.change('detach', 'high')}:detach:high")
    live.goes_on()
    os.kill(before["low"], signal.SIGKILL)
    until(lambda: pids(live)["low"] not in (None, before["low"]), "another process")
    live.goes_on()
    live.is_repeated_by(*schedule)
    assert any("high: it leaves its process: high: another process runs it" in line for line in live.launch.err)


def test_a_replacement_that_fails_in_its_first_epoch_leaves_the_old_one_where_it_is(live: Live) -> None:
    before, path = pids(live), live.folder / "failing.yaml"
    failing = '{class: "support.failing_nodes:Failing", parameters: {name: high, operator: predict}}'
    path.write_text(f"nodes:\n  high: {failing}\n", encoding="utf-8")
    done = live.hierax("replace", "high", str(path))
    assert (done.returncode, "what it was to replace goes on" in done.stderr) == (1, True), done.stderr
    live.goes_on()
    assert pids(live) == before
    live.is_repeated_by()


def test_tools_show_nodes_by_process(live: Live) -> None:
    listed = live.hierax("ps").stdout.splitlines()
    assert listed[1].split()[:3] == ["process", "node", "state"]
    rows = [line.split() for line in listed[3:]]
    assert [row[:2] for row in rows] == [["mind", "high"], ["mind", "low"], ["world", "running"]]
    assert rows[0][3] == rows[1][3] != rows[2][2]
    look = live.hierax("top", "--once", "--interval", "0.2").stdout
    assert [line.split()[:2] for line in look.splitlines() if "mind" in line] == [["mind", "high"], ["mind", "low"]]
    run = live.run["run"]
    for name, nodes in (("mind", {"low", "high"}), ("low", {"low"})):
        told = live.hierax("logs", "--run", run, "--node", name, "--format", "json").stdout.splitlines()
        assert {json.loads(line)["node"] for line in told} == nodes
        assert {json.loads(line)["process"] for line in told} == {"mind"}
    assert "mind/low epoch 0: process " in live.hierax("logs", "--run", run).stdout


FAILING = """\
hierarchy: failing
world: world
epochs: 200
processes: {all: ["*"]}
nodes:
  world: {class: "hierax.runtime.sim.nodes:MixingWorld", parameters: {name: world, policies: 2}}
  low: {class: "hierax.runtime.sim.nodes:Drawer", parameters: {name: low}}
  bad:
    class: "support.failing_nodes:Failing"
    parameters: {name: bad, epoch: 50}
    on_loss: detach
edges:
  world -> low: {sense: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: a}}}
  low -> bad: {sense: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: b}}}
"""


def test_a_node_that_fails_alone_leaves_the_process(tmp_path: Path) -> None:
    file = tmp_path / "failing.yaml"
    file.write_text(FAILING, encoding="utf-8")
    with Launched(tmp_path, str(file)) as launch:
        report = launch.report()
    assert report["digest"] == run_here(str(file))["digest"]
    assert sorted(report["nodes"]) == ["low", "world"]
    assert "bad is detached (on_loss)" in launch.err
    assert "started again" not in launch.err


def test_a_node_that_cannot_go_on_ends_the_run_with_its_own_words(tmp_path: Path) -> None:
    file = tmp_path / "failing.yaml"
    file.write_text(FAILING.replace("    on_loss: detach\n", ""), encoding="utf-8")
    with Launched(tmp_path, str(file)) as launch:
        launch.end()
    assert launch.process.returncode == 1
    assert "error: bad: observe in epoch 50: RuntimeError: out of luck" in launch.err


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_hierarchy_is_cut_by_the_command(count: int, tmp_path: Path) -> None:
    with Launched(tmp_path, "letters", "--epochs", "300", "--processes", str(count)) as launch:
        launch.until_epoch(1)
        names = [path.name.removesuffix(".lock") for path in launch.state.glob("*.lock")]
        found = {launch.pid(name) for name in names} - {0}
        report = launch.report()
    assert len(found) <= count
    assert report["digest"] == run_here("letters", "--epochs", "300")["digest"]


def test_a_recording_has_all_that_is_said_in_a_process_and_says_how_to_cut(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    with Launched(tmp_path, "letters", "--epochs", "30", "--processes", "1", "--record", str(recording)) as launch:
        digest = launch.report()["digest"]
    again = tmp_path / "again"
    again.mkdir()
    options = ("--epochs", "30", "--processes", "2", "--traffic", str(recording), "--check")
    with Launched(again, "letters", *options) as launch:
        assert launch.report()["digest"] == digest


WRONG: list[tuple[tuple[str, ...], Callable[[str], bool]]] = [
    (("--traffic", "x.mcap"), lambda said: "--traffic: only with --processes" in said),
    (("--processes", "0"), lambda said: "'--processes': Input should be greater than or equal to 1" in said),
    (("--processes", "2", "--traffic", "nothing.mcap"), lambda said: "nothing.mcap: cannot be read" in said),
]


@pytest.mark.parametrize(("options", "is_told"), WRONG)
def test_options_that_mean_nothing_are_refused(
    options: tuple[str, ...], is_told: Callable[[str], bool], tmp_path: Path
) -> None:
    with Launched(tmp_path, "servo", *options) as launch:
        launch.end()
    assert launch.process.returncode != 0
    assert is_told(launch.err), launch.err


def test_a_process_that_hangs_is_killed_with_all_its_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("support.live.DEPLOYMENT", TOGETHER)
    live = Live(tmp_path, "--set", "epoch_deadline_s=2", pace_s=0.01)
    try:
        before = pids(live)
        os.kill(before["low"], signal.SIGSTOP)
        until(lambda: pids(live)["low"] not in (None, before["low"]), "another process")
        live.goes_on()
        after = live.run["nodes"]
        assert after["low"]["pid"] == after["high"]["pid"]
        assert after["world"]["restarts"] == 0
        live.is_repeated_by()
        assert len([line for line in live.launch.err if "started again" in line]) == 1
    finally:
        live.close()
