"""The shipped networks: exact in every epoch, equal in one process and in many, with parts that come and go."""

from __future__ import annotations

import json
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import yaml
from support.launched import Launched, hierax, run_here, said_here
from support.pace import paced
from support.parts import KEPT, active, advanced, believed, largest_error, write_deployment

from hierax.nodes.causal_tree import Part, epochs_needed, network_from, posteriors, random_tree
from hierax.runtime.deployment.deployment import shipped
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_schedule
from hierax.runtime.execution.single import run

CLOSE = 1e-12
TREE, ALARM = shipped()["causal-tree"], shipped()["alarm"]
NETWORK = network_from(yaml.safe_load(TREE.read_text(encoding="utf-8"))["parameters"]["network"])


def vectors(evidence: dict[str, Any]) -> dict[str, Any]:
    return {
        name: np.eye(len(NETWORK.variables[name].states))[seen] if isinstance(seen, int) else seen
        for name, seen in evidence.items()
    }


def test_every_epoch_of_the_shipped_tree_is_exact() -> None:
    hierarchy = active(TREE)
    shown = 0
    for _ in range(6):
        evidence = hierarchy.states["world"].belief["evidence"]
        shown += len(evidence)
        hierarchy = advanced(hierarchy, 1)
        assert largest_error(believed(hierarchy), posteriors(NETWORK, vectors(evidence))) < CLOSE
    assert shown > 6 * 30


def test_the_shipped_alarm() -> None:
    hierarchy = advanced(active(ALARM), 4)
    assert believed(hierarchy)["burglary"][1] == pytest.approx(0.284171835, abs=1e-9)  # both call
    hierarchy = advanced(hierarchy, 2)
    assert believed(hierarchy)["burglary"][1] == pytest.approx(0.003262, abs=1e-6)  # and there is an earthquake
    content = yaml.safe_load(ALARM.read_text(encoding="utf-8"))["parameters"]
    assert content["hold"] == content["settle"] == epochs_needed(content["network"])


@pytest.mark.parametrize(("name", "epochs"), [("causal-tree", "200"), ("alarm", "12")])
def test_a_launch_is_the_run(name: str, epochs: str) -> None:
    wanted = run_here(name, "--epochs", epochs)
    report = hierax("launch", name, "--epochs", epochs)
    assert (report["digest"], report["nodes"]) == (wanted["digest"], wanted["nodes"])


def final(schedule: list[str], epochs: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The posteriors of the shipped tree after a changed run, and the evidence of the last epoch."""
    deployment = read_deployment(TREE)
    report = run(deployment, epochs=epochs, seed=0, schedule=read_schedule(schedule, deployment))
    found: dict[str, np.ndarray] = {}
    evidence: dict[str, Any] = {}
    for name, node in report.nodes.items():
        if name != "world":
            parameters = deployment.roster.nodes[name].parameters
            found.update(Part(**parameters).posteriors(node.belief))
            evidence.update(node.belief["evidence"]["world"])
    return found, evidence


def test_a_detached_subtree_says_nothing_and_an_attached_one_does() -> None:
    whole, evidence = final([], 9)
    assert largest_error(whole, posteriors(NETWORK, vectors(evidence))) < CLOSE
    found, left = final(["4:detach:branch4"], 9)
    gone = whole.keys() - found.keys()
    assert 50 < len(gone) < 150
    assert left == {name: seen for name, seen in evidence.items() if name not in gone}
    exact = {name: row for name, row in posteriors(NETWORK, vectors(left)).items() if name not in gone}
    assert largest_error(found, exact) < CLOSE
    assert max(float(np.abs(found[name] - whole[name]).max()) for name in found) > 1e-3
    again, _ = final(["4:detach:branch4", "8:attach:branch4"], 9)
    assert [row.tolist() for row in again.values()] == [row.tolist() for row in whole.values()]


def test_subtrees_come_and_go_while_evidence_streams(tmp_path: Path) -> None:
    with Launched(tmp_path, paced(tmp_path, "causal-tree"), "--epochs", "1000000") as launch:
        launch.until_epoch(5)
        schedule = []
        for kind in ("detach", "attach"):
            epoch = json.loads(said_here(kind, "branch2", "--format", "json", folder=tmp_path).stdout)["epoch"]
            schedule += ["--at", f"{epoch}:{kind}:branch2"]
        launch.until_epoch(epoch + 20)
        launch.process.send_signal(signal.SIGTERM)
        launch.end()
        digests = launch.written
    repeated = tmp_path / "repeated"
    run_here("causal-tree", "--epochs", str(epoch + 20), "--output", str(repeated), *schedule)
    with (repeated / "digests.msgpack").open("rb") as entries:
        wanted = dict(msgpack.Unpacker(entries))
    assert {number: digests[number] for number in wanted} == wanted, schedule


# --- epochs that overlap, and free running

HELD = 40
NO_RATES: Mapping[str, float] = {}


def loosened(
    folder: Path, polytree: bool, rates_hz: Mapping[str, float] = NO_RATES, **fields: Any
) -> tuple[Any, dict[str, dict[int, Any]], list[dict[str, Any]]]:
    """A network in loose epochs, two evidence sets held for a long time each: its beliefs by node and epoch."""
    network: list[dict[str, Any]] = random_tree(7, 2, 5)
    if polytree:
        network[3] = {"id": "n3", "states": 2, "parents": [], "prior": [0.2, 0.8]}
        network[4] = {
            **network[4],
            "parents": ["n0", "n3"],
            "cpt": np.random.default_rng(1).dirichlet([1, 1], (2, 2)).tolist(),
        }
    parents = {parent for entry in network for parent in entry["parents"]}
    leaves = [entry["id"] for entry in network if entry["id"] not in parents]
    sets = [dict.fromkeys(leaves, 0), dict.fromkeys(leaves, 1)]
    path = write_deployment(folder, network, sets)
    content = yaml.safe_load(path.read_text())
    content["nodes"]["world"]["parameters"]["hold"] = HELD
    content["probes"] = []
    for name, node in content["nodes"].items():
        content["probes"].append({"node": name, "class": "support.parts:Keep", "parameters": {"node": name}})
        if name != "world":
            node["parameters"]["settle"] = None
    for name, rate_hz in rates_hz.items():
        content["nodes"][name]["rate_hz"] = rate_hz
    path.write_text(yaml.safe_dump({**content, **fields}))
    KEPT.clear()
    run(read_deployment(path), epochs=2 * HELD + 5, seed=3)
    return network, {name: dict(beliefs) for name, beliefs in KEPT.items()}, sets


def errors(network: Any, kept: dict[str, dict[int, Any]], sets: Any, epoch: int) -> float:
    """How far all nodes' beliefs of an epoch, or of their last one before it, are from those of its evidence."""
    evidence = sets[(epoch - 1) // HELD % 2]
    exact = posteriors(network, {name: np.eye(2)[state] for name, state in evidence.items()})
    found = {}
    for entry in network:
        beliefs = kept[entry["id"]]
        found[entry["id"]] = beliefs[max(each for each in beliefs if each <= epoch)]["posterior"][0]
    return largest_error(found, exact)


@pytest.mark.parametrize("polytree", [False, True])
@pytest.mark.parametrize("staleness", [1, 2])
def test_with_a_staleness_beliefs_become_exact_within_the_bound(staleness: int, polytree: bool, tmp_path: Path) -> None:
    network, kept, sets = loosened(tmp_path, polytree, staleness=staleness)
    depth = max(len(way) for way in ways_up(network))
    within = (staleness + 1) * 2 * depth * epochs_needed(network)
    assert within < HELD
    for epoch in (within, HELD, HELD + within, 2 * HELD):
        assert errors(network, kept, sets, epoch) < CLOSE, epoch


def ways_up(network: Any) -> list[list[str]]:
    """From each node to each root above it."""
    parents = {entry["id"]: entry["parents"] for entry in network}
    ways = [[name] for name in parents]
    done = []
    while ways:
        way = ways.pop()
        ways += [[*way, parent] for parent in parents[way[-1]]]
        done += [way] if not parents[way[-1]] else []
    return done


@pytest.mark.parametrize("polytree", [False, True])
def test_free_running_converges(polytree: bool, tmp_path: Path) -> None:
    network, kept, sets = loosened(tmp_path, polytree, {"world": 30.0, "n1": 10.0}, staleness=None)
    assert errors(network, kept, sets, HELD) < CLOSE
    assert errors(network, kept, sets, 2 * HELD) < CLOSE
    assert len(kept["n1"]) < HELD  # most epochs it has left out
