"""Networks in files: JSON, YAML and BIF, and what is wrong with them."""

from __future__ import annotations

import json
import os
import re
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.causal_tree import NetworkError, read_network

NODES = [
    {"id": "rain", "states": ["no", "yes"], "prior": [0.7, 0.3]},
    {"id": "wet", "states": 2, "parents": ["rain"], "cpt": [[0.9, 0.1], [0.2, 0.8]]},
]
YAML = """\
network:
  - {id: rain, states: ["no", "yes"], prior: [0.7, 0.3]}
  - {id: wet, states: 2, parents: [rain], cpt: [[0.9, 0.1], [0.2, 0.8]]}
"""
BIF = """\
network "collider" {}
variable a { type discrete[2] {no, yes}; }
variable b { type discrete[3] {low, middle, high}; }
variable c { type discrete[2] {off, on}; }
probability (a) { table 0.25 0.75; }
probability (b) { table 0.2 0.3 0.5; }
probability (c | a, b) {
  (no, low) 0.125 0.875; (no, middle) 0.25 0.75; (no, high) 0.375 0.625;
  (yes, low) 0.5 0.5; (yes, middle) 0.625 0.375; (yes, high) 1.0 0.0;
}
"""


def with_pyagrum() -> None:
    with warnings.catch_warnings():  # where they are errors, those of its import end the process
        warnings.simplefilter("ignore")
        pytest.importorskip("pyagrum")


@pytest.mark.parametrize(("name", "text"), [("n.json", json.dumps(NODES)), ("n.yml", YAML), ("n.YAML", YAML)])
def test_json_and_yaml(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    network = read_network(path)
    assert network.variables["rain"].states == ("no", "yes")
    assert network.variables["wet"].table.tolist() == [[0.9, 0.1], [0.2, 0.8]]


def test_numbers_and_states_in_yaml_are_what_they_look_like(tmp_path: Path) -> None:
    path = tmp_path / "n.yaml"
    path.write_text("- {id: on, states: [no, yes, 3], prior: [1e-12, 0.5, 0.499999999999]}\n")
    variable = read_network(path).variables["on"]
    assert variable.states == ("no", "yes", "3")
    assert variable.table.tolist() == [1e-12, 0.5, 0.499999999999]


def test_bif(tmp_path: Path) -> None:
    with_pyagrum()
    path = tmp_path / "collider.bif"
    path.write_text(BIF)
    network = read_network(path)
    assert network.variables["b"].states == ("low", "middle", "high")
    variable = network.variables["c"]
    rows = {("a", "b"): (2, 3, 2), ("b", "a"): (3, 2, 2)}
    assert variable.table.shape == rows[tuple(map(str, variable.parents))]
    table = variable.table if variable.parents == ("a", "b") else variable.table.transpose(1, 0, 2)
    np.testing.assert_allclose(table[..., 0], [[0.125, 0.25, 0.375], [0.5, 0.625, 1.0]], atol=0.0)
    np.testing.assert_allclose(network.variables["b"].table, [0.2, 0.3, 0.5], atol=0.0)


@pytest.mark.parametrize(
    ("told", "instead", "message"),
    [
        ("table 0.25 0.75;", "table 0.25 0.75 0.3;", "node 'a': table: expected 2 numbers, got 3"),
        ("table 0.25 0.75;", "table 1.0;", "node 'a': table: expected 2 numbers, got 1"),
        ("(no, low) 0.125 0.875;", "(no, low) 0.125 0.875 0;", "node 'c': (no,low): expected 2 numbers, got 3"),
        ("(no, low) 0.125 0.875;", "default 1.0;", "node 'c': default: expected 2 numbers, got 1"),
        ("(no, middle) 0.25", "(no,low) 0.25", "node 'c': (no,low): expected one such row, got two"),
        (
            "table 0.25 0.75; }",
            "table 0.5 0.5; } probability (a) { table 1 0; }",
            "node 'a': table: expected one",
        ),
    ],
)
def test_a_row_of_a_bif_that_says_too_little_or_too_much(tmp_path: Path, told: str, instead: str, message: str) -> None:
    with_pyagrum()
    path = tmp_path / "n.bif"
    path.write_text(BIF.replace(told, instead))
    with pytest.raises(NetworkError, match=re.escape(message)):
        read_network(path)


def test_bif_without_pyagrum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "collider.bif"
    path.write_text(BIF)
    monkeypatch.setitem(sys.modules, "pyagrum", None)
    with pytest.raises(NetworkError, match=r"BIF needs pyAgrum, which is not installed: pip install 'hierax\[bayes\]'"):
        read_network(path)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("n.json", "[{", "n.json: is no JSON: Expecting property name"),
        ("n.yaml", "a: [", "n.yaml:1: no valid YAML: expected the node content"),
        ("n.yaml", "network: []", "n.yaml: expected a list of nodes, got an empty one"),
        ("n.json", json.dumps([{**NODES[0], "prior": [0.7, 0.4]}]), "n.json: node 'rain': prior: the numbers should"),
        ("n.txt", "", "n.txt: expected a file with the ending .json, .yaml, .yml, .bif"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_node(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(NetworkError, match=re.escape(message)):
        read_network(path)


def test_a_broken_bif(tmp_path: Path) -> None:
    with_pyagrum()
    path = tmp_path / "broken.bif"
    path.write_text("garbage")
    with pytest.raises(NetworkError, match=r"broken\.bif: is no BIF: "):
        read_network(path)


def test_a_bif_with_a_loop(tmp_path: Path) -> None:
    with_pyagrum()
    path = tmp_path / "loop.bif"
    text = BIF.replace(
        "probability (b) { table 0.2 0.3 0.5; }", "probability (b | a) { (no) 0.2 0.3 0.5; (yes) 0.1 0.1 0.8; }"
    )
    path.write_text(text)
    with pytest.raises(NetworkError, match=r"loop\.bif: there is an undirected loop, "):
        read_network(path)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(NetworkError, match=r"none\.json: cannot be read: No such file"):
        read_network(tmp_path / "none.json")
    (tmp_path / "latin.yaml").write_bytes(b"- {id: \xe4}")
    with pytest.raises(NetworkError, match=r"latin\.yaml: byte 0xe4 is not UTF-8"):
        read_network(tmp_path / "latin.yaml")


def bomb(leaves: int = 8) -> str:
    """Ten lists of ten lists … by aliases: a hundred million numbers in a kilobyte."""
    levels = ["x0: &x0 [1,1,1,1,1,1,1,1,1,1]"]
    levels += [f"x{i}: &x{i} [{','.join([f'*x{i - 1}'] * 10)}]" for i in range(1, leaves)]
    return "\n".join(levels) + f"\nnetwork: [{{id: a, states: 2, prior: *x{leaves - 1}}}]\n"


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        (
            "n.json",
            '[{"id": "a", "states": 1000000000000, "prior": [1]}]',
            "node 'a': states: 1000000000000 of them; at most",
        ),
        ("n.yaml", "[{id: a, states: 1000000000000, prior: [1]}]", "node 'a': states: 1000000000000 of them; at most"),
        ("n.yaml", bomb(), "the document has more than 262144 values"),
        ("n.yaml", "&a [*a]", "nested deeper than 64 levels"),
        ("n.yaml", "[" * 5000, "nested deeper than 64 levels"),
        ("n.json", "[" * 100_000, "is nested too deeply"),
        ("n.bif", BIF.replace("discrete[2] {no", "discrete[400000000] {no"), "node 'a': states: 4e\\+08 of them"),
        ("n.yaml", "2026-13-45", "expected a list of nodes, got str"),
    ],
)
def test_what_would_be_too_large_is_refused_before_it_is_made(tmp_path: Path, name: str, text: str, told: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(NetworkError, match=told):
        read_network(path)


def test_tables_of_many_parents_are_refused_before_they_are_made(tmp_path: Path) -> None:
    names = [f"p{number}" for number in range(40)]
    nodes = [{"id": name, "states": 2, "prior": [0.5, 0.5]} for name in names]
    path = tmp_path / "n.json"
    path.write_text(json.dumps([*nodes, {"id": "all", "states": 2, "parents": names, "cpt": [0.5, 0.5]}]))
    with pytest.raises(NetworkError, match=r"node 'all': .* numbers; at most 16777216 \(134217728 bytes\)"):
        read_network(path)
    variables = "".join(f"variable {name} {{ type discrete[2] {{no, yes}}; }}\n" for name in names)
    bif = tmp_path / "n.bif"
    bif.write_text(f'network "n" {{}}\n{variables}probability (p0 | {", ".join(names[1:])}) {{ table 1 0; }}\n')
    with pytest.raises(NetworkError, match=r"node 'p0': .* numbers; at most"):
        read_network(bif)


@pytest.mark.parametrize("beginning", ["variable a {", "probability (", "variable a { [", "variable ", "[ "])
def test_a_bif_of_nothing_but_beginnings_is_checked_at_once(
    tmp_path: Path, beginning: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "n.bif"
    path.write_text(beginning * 8000)
    monkeypatch.setitem(sys.modules, "pyagrum", None)  # which is asked once the file is checked
    start = time.process_time()
    with pytest.raises(NetworkError, match="BIF needs pyAgrum"):
        read_network(path)
    assert time.process_time() - start < 2  # milliseconds; ten seconds and more where it is quadratic


def test_so_many_parents_that_no_float_counts_the_numbers(tmp_path: Path) -> None:
    path = tmp_path / "n.bif"
    variables = "".join(f"variable p{number} {{ type discrete[2] {{no, yes}}; }}\n" for number in range(1100))
    names = ", ".join(f"p{number}" for number in range(1, 1100))
    path.write_text(f"{variables}probability (p0 | {names}) {{ table 1 0; }}\n")
    with pytest.raises(NetworkError, match=r"node 'p0': .* have inf numbers; at most"):
        read_network(path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "n.json"
    os.mkfifo(path)
    with pytest.raises(NetworkError, match="is no file"):
        read_network(path)


EXACT = """\
// variable big { type discrete [ 9999999 ] { a }; }
network "exact // no comment" { }
variable rain { type discrete[2] { 0, 1 }; }
variable wet { type discrete[2] { no, yes }; }  /* probability (wet) { table 2 3; } */
probability (rain) { table .7, 3E-1; }
probability (wet | rain) {
  default 1.0 0.0;
  (1) 0.9999999999 1e-10;  // and not 0.5
}
"""


def test_numbers_of_a_bif_are_read_in_double_precision(tmp_path: Path) -> None:
    with_pyagrum()
    path = tmp_path / "exact.bif"
    path.write_text(EXACT)
    variables = read_network(path).variables
    assert variables["rain"].states == ("0", "1")
    assert variables["rain"].table.tolist() == [0.7, 0.3]
    assert variables["wet"].table.tolist() == [[1.0, 0.0], [0.9999999999, 1e-10]]


@pytest.mark.parametrize("many", ['"' * 20_001, "/*" * 20_000])
def test_a_bif_of_openings_is_refused_at_once(tmp_path: Path, many: str) -> None:
    with_pyagrum()
    path = tmp_path / "n.bif"
    path.write_text(many)
    with pytest.raises(NetworkError, match=r"n\.bif"):
        read_network(path)
