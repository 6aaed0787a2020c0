"""``hierax infer``: posteriors of a file, as a table and as JSON, and errors with file and node."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hierax.runtime.commands.main import main

NETWORK = """\
- {id: rain, states: ["no", "yes"], prior: [0.7, 0.3]}
- {id: wet, states: 2, parents: [rain], cpt: [[0.9, 0.1], [0.2, 0.8]]}
- {id: 7, states: [1, 2], parents: [wet], cpt: [[1.0, 0.0], [0.5, 0.5]]}
"""


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "rain.yaml"
    path.write_text(NETWORK)
    return str(path)


def test_as_a_table(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["infer", file, "--evidence", "wet=1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{file}: 3 nodes, ln P(evidence) = -1.17118298"
    cells = [line.split() for line in lines[4:]]
    assert cells == [
        ["rain", "no", "0.225806452"],
        ["yes", "0.774193548"],
        ["wet", "0", "0"],
        ["1", "1"],
        ["7", "1", "0.5"],
        ["2", "0.5"],
    ]


@pytest.mark.parametrize(
    ("evidence", "rain"),
    [
        ([], 0.3),
        (["rain=yes"], 1.0),
        (["rain=0"], 0.0),
        (["wet=[0.2, 0.4]"], 0.54 / 1.31),
        (["wet=[1e-320,0]", "7=1"], 0.06 / 0.69),
        (["7=2"], 0.24 / 0.31),
    ],
)
def test_as_json(file: str, evidence: list[str], rain: float, capsys: pytest.CaptureFixture[str]) -> None:
    options = [word for each in evidence for word in ("-e", each)]
    assert main(["infer", file, *options, "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["file", "log_evidence", "posteriors"]
    assert list(found["posteriors"]) == ["rain", "wet", "7"]
    assert found["posteriors"]["rain"]["yes"] == pytest.approx(rain, abs=1e-12)


@pytest.mark.parametrize(
    ("evidence", "message"),
    [
        (["rian=yes"], "--evidence rian=yes: there is no node 'rian'; did you mean 'rain'?"),
        (
            ["rain=maybe"],
            "--evidence rain=maybe: evidence for 'rain': there is no state 'maybe'; expected one of no, yes",
        ),
        (["wet=2"], "--evidence wet=2: evidence for 'wet': there is no state 2; expected one of 0, 1"),
        (["wet=" + "1" * 5000], "--evidence wet=1111"),
        (
            ["rain=[1]"],
            "--evidence rain=[1]: evidence for 'rain': expected 2 likelihoods, one for each state, got [1.0]",
        ),
        (["rain=[1, -1]"], "--evidence rain=[1, -1]: evidence for 'rain': expected finite numbers of at least 0"),
        (["rain"], "--evidence rain: expected NAME=STATE, or NAME=[likelihood,…]"),
        (["rain=no", "rain=yes"], "--evidence rain=yes: node 'rain' has evidence already"),
        (["wet=0", "7=2"], "the evidence is impossible: it leaves no state of node 'wet'"),
    ],
)
def test_what_is_wrong_is_one_line(
    file: str, evidence: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["infer", file, *(word for each in evidence for word in ("-e", each))]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"error: {message}")
    assert err.count("\n") == 1


def test_ids_that_are_one_text_are_told_with_file_and_node(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "same.yaml"
    path.write_text("".join(f"- {{id: {name}, states: 2, prior: [0.5, 0.5]}}\n" for name in ("1", "2", "'1'")))
    assert main(["infer", str(path)]) == 1
    expected = "expected ids that differ as texts, got 1 and '1'"
    assert capsys.readouterr() == ("", f"error: {path}: node '1': id: {expected}\n")


def test_a_wrong_file_is_told_with_its_node(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(NETWORK.replace("0.3]", "0.4]"))
    assert main(["infer", str(path)]) == 1
    assert capsys.readouterr().err == (f"error: {path}: node 'rain': prior: the numbers should sum to 1, not 1.1\n")
