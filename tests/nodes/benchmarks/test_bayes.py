"""``hierax bench bayes``: the same posteriors by all ways, and what is said of those that have none."""

from __future__ import annotations

import json
import sys
import warnings

import numpy as np
import pytest

from hierax.nodes.benchmarks import bayes
from hierax.nodes.benchmarks.bayes import Limit, reference
from hierax.nodes.causal_tree import posteriors, random_tree
from hierax.runtime.commands.main import main


def with_pyagrum() -> None:
    with warnings.catch_warnings():  # where they are errors, those of its import end the process
        warnings.simplefilter("ignore")
        pytest.importorskip("pyagrum")


@pytest.mark.parametrize("nodes", [1, 2, 40, 300])
def test_the_limit_and_the_reference_are_right(nodes: int) -> None:
    network = random_tree(nodes, 4, seed=nodes)
    evidence = {f"n{number}": number % 4 for number in range(1, nodes, 3)}
    exact = posteriors(network, {name: np.eye(4)[state] for name, state in evidence.items()})
    limit = Limit(network)
    for found in (limit(evidence), limit(evidence), reference(network, evidence)):
        assert max(float(np.abs(found[str(name)] - row).max()) for name, row in exact.items()) < 1e-12


def test_ours_beside_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    with_pyagrum()
    assert main(["bench", "bayes", "--nodes", "6,31", "--rounds", "1", "--format", "json"]) == 0
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert [cell["nodes"] for cell in cells] == [6] * 5 + [31] * 5
    for cell in cells:
        if not cell["way"].startswith("pgmpy"):
            assert cell["update_ms"] > 0, cell
            assert cell["error"] < 1e-12, cell


def test_as_a_table_without_the_others(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for module in ("pyagrum", "pgmpy.factors.discrete", "pgmpy"):
        monkeypatch.setitem(sys.modules, module, None)
    assert main(["bench", "bayes", "--nodes", "8", "--rounds", "1"]) == 0
    out = capsys.readouterr().out
    assert "hierax" in out
    assert "numpy, level by level" in out
    assert "pyAgrum, lazy propagation, 8 nodes: pyagrum is not installed" in out
    assert "pgmpy, belief propagation, 8 nodes: pgmpy" in out


def test_a_rival_that_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(network: bayes.Description) -> bayes.Update:
        raise ValueError("the evidence is impossible")

    monkeypatch.setattr(bayes, "RIVALS", {"failing": (fails, 100), "small": (fails, 3)})
    cells = {cell.way: cell for cell in bayes.bench_bayes([8], 1, 1, lambda what: None)}
    assert cells["failing"].note == "failed: ValueError: the evidence is impossible"
    assert cells["small"].note == "left out: more than 3 nodes"
    assert cells["failing"].update_ms is None


def test_the_fast_form_is_at_most_twice_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """In CPU time of the same run; what else the machine does is in both."""
    monkeypatch.setattr(bayes, "RIVALS", {})
    ratios = []
    for _ in range(3):
        cells = {cell.way: cell for cell in bayes.bench_bayes([1000], 3, 1, lambda what: None)}
        ours, limit = cells[bayes.OURS].update_ms, cells[bayes.LIMIT].update_ms
        assert ours is not None
        assert limit is not None
        ratios.append(ours / limit)
    assert min(ratios) <= 2.0, ratios


@pytest.mark.parametrize("nodes", ["", "10,x", "0", "10,,20", "-3"])
def test_sizes_that_are_none(nodes: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "bayes", "--nodes", nodes]) == 1
    assert "--nodes: expected numbers of at least 1" in capsys.readouterr().err
