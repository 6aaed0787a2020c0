from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from support.deployments import line_of, replaced, write

from hierax.runtime.deployment import DeploymentError
from hierax.runtime.deployment.deployment import Deployment, ProcessTerms
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_attach, read_replace, read_terms
from hierax.schemas.roster import Attach, Reference, Replace, RosterEdge

SNIPPET = """\
nodes:
  second:
    class: support.toy_nodes:Summer
    parameters: {scale: "${scale}", weights: [1, 2]}
    on_loss: detach
  third: {class: support.toy_nodes:Summer}
edges:
  second->third: {sense: support.toy_nodes:seen}
  left -> second:
    sense: support.toy_nodes:seen
    context: {function: "support.toy_nodes:Scale", parameters: {factor: 2}, enabled: "${context}"}
"""

ONE = """\
nodes:
  left: {class: support.toy_nodes:Summer, parameters: {scale: 3}}
"""

SEEN = Reference("support.toy_nodes:seen")


def deployment(folder: Path, *settings: str) -> Deployment:
    return read_deployment(write(folder), settings)


def snippet(folder: Path, text: str = SNIPPET) -> Path:
    return write(folder, text, "snippet.yaml")


def test_nodes_to_attach(tmp_path: Path) -> None:
    assert read_attach(snippet(tmp_path), deployment(tmp_path)) == Attach(
        {
            "second": Reference("support.toy_nodes:Summer", {"scale": 0.5, "weights": (1, 2)}),
            "third": Reference("support.toy_nodes:Summer"),
        },
        (
            RosterEdge("left", "second", SEEN, None, Reference("support.toy_nodes:Scale", {"factor": 2})),
            RosterEdge("second", "third", SEEN),
        ),
    )


def test_parameters_are_the_runs_own(tmp_path: Path) -> None:
    attach = read_attach(snippet(tmp_path), deployment(tmp_path, "scale=7", "context=false"))
    assert attach.nodes["second"].parameters["scale"] == 7
    assert attach.edges[0].context is None


def test_a_node_of_the_deployment_file_with_its_edges(tmp_path: Path) -> None:
    read = deployment(tmp_path)
    edges = tuple(edge for edge in read.roster.edges if "left" in edge.pair)
    assert len(edges) == 2
    assert read_attach("left", read) == Attach({"left": read.roster.nodes["left"]}, edges)


def test_a_file_comes_before_a_node_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, SNIPPET, "left")
    monkeypatch.chdir(tmp_path)
    assert set(read_attach("left", deployment(tmp_path)).nodes) == {"second", "third"}


def test_a_node_to_replace(tmp_path: Path) -> None:
    new = Reference("support.toy_nodes:Summer", {"scale": 3})
    read = deployment(tmp_path)
    assert read_replace(snippet(tmp_path, ONE), "left", read) == Replace("left", new)
    assert read_replace(snippet(tmp_path, f"{ONE}edges:\n"), "left", read) == Replace("left", new)
    assert read_replace(snippet(tmp_path, f"{ONE}edges: {{}}\n"), "left", read) == Replace("left", new, ())
    text = f"{ONE}edges:\n  left -> top.most: {{}}\n  world -> left: {{sense: support.toy_nodes:seen}}\n"
    assert read_replace(snippet(tmp_path, text), "left", read).edges == (
        RosterEdge("left", "top.most"),
        RosterEdge("world", "left", SEEN),
    )


def test_what_is_said_about_restarts(tmp_path: Path) -> None:
    read = deployment(tmp_path, "restart.max_restarts=1", "nodes.left.max_restarts=2")
    other = ProcessTerms(max_restarts=1)
    assert read_terms(snippet(tmp_path), read) == {"second": replace(other, on_loss="detach"), "third": other}
    assert read_terms("left", read) == {"left": ProcessTerms(max_restarts=2)}


def test_what_is_said_about_rates_budgets_and_scheduling(tmp_path: Path) -> None:
    read = deployment(tmp_path, "staleness=null", "nodes.left.budget_ms=7", "nodes.left.rate_hz=3")
    text = ONE.replace("{class", "{budget_ms: 9, scheduling: {cpus: [0]}, class")
    asked = {"policy": "other", "priority": 1, "cpus": [0]}
    path = snippet(tmp_path, text)
    assert read_terms(path, read) == {"left": ProcessTerms(rate_hz=3, budget_ms=9, scheduling=asked)}
    of_its_own = read_terms(path, read, attached=True)["left"]
    assert (of_its_own.rate_hz, of_its_own.budget_ms) == (None, 9), "what is attached takes nobody's place"
    barrier = read_deployment(read.path)
    with pytest.raises(DeploymentError, match=r"nodes\.left\.rate_hz: nodes have rates only in free running"):
        read_terms(snippet(tmp_path, text.replace("budget_ms", "rate_hz")), barrier)


def test_what_is_attached_fails_alone_unless_a_file_says_otherwise(tmp_path: Path) -> None:
    path = snippet(tmp_path)
    read = deployment(tmp_path)
    assert {name: each.on_loss for name, each in read_terms(path, read, attached=True).items()} == {
        "second": "detach",
        "third": "detach",
    }
    assert read_terms("left", read, attached=True)["left"].fails_alone
    other = read_deployment(read.path, ["restart.on_loss=stop"])
    assert [each.on_loss for each in read_terms(path, other, attached=True).values()] == ["detach", "stop"]
    own = read_deployment(read.path, ["nodes.left.on_loss=restart"])
    assert read_terms("left", own, attached=True)["left"].on_loss == "restart"
    assert not ProcessTerms(restart_policy="always", on_loss="detach").fails_alone


MISTAKES = [
    # a part of the right snippet, what stands there instead, the mistake's line, the message after file and line
    ("nodes:\n", "node:\n", "node:", "node: unknown field; did you mean 'nodes'?"),
    ("edges:", "probes: []\nedges:", "probes", "probes: unknown field; expected one of edges, nodes"),
    (
        "edges:",
        "parameters: {a: 1}\nedges:",
        "parameters: {a",
        "parameters: unknown field; expected one of edges, nodes",
    ),
    ('"${scale}"', '"${scales}"', "    parameters", "nodes.second.parameters.scale: unknown parameter ${scales}; did"),
    ("    class", "    clas", "    clas", "nodes.second.clas: unknown field; did you mean 'class'?"),
    (
        "    class: support.toy_nodes:Summer\n",
        "",
        "  second:",
        "nodes.second.class: missing; expected module:name of a",
    ),
    ("on_loss: detach", "on_loss: detatch", "    on_loss", "nodes.second.on_loss: expected 'restart', 'detach' or"),
    (
        "on_loss: detach",
        "on_loss: ${scale}",
        "    on_loss",
        "nodes.second.on_loss: expected 'restart', 'detach' or 'stop', got 0.5 (from ${scale}, DEPLOYMENT:7)",
    ),
    ("third: {class", "th ird: {class", "  th ird", "nodes.th ird: 'th ird' is no node's name: expected at most"),
    ("left -> second", "left > second", "  left >", "edges.left > second: 'left > second' is no edge"),
    (
        "left -> second",
        "world -> left",
        "  world ->",
        "edges.world -> left: joins two other nodes; expected an edge of 'second' or 'third'",
    ),
    ("left -> second", "second -> third", "  second -> third", "edges.second -> third: given twice, in line 8 and"),
]


@pytest.mark.parametrize(
    ("old", "new", "part", "message"), MISTAKES, ids=[f"{new[:30]!r}" for _, new, _, _ in MISTAKES]
)
def test_a_mistake_is_told_in_one_line(tmp_path: Path, old: str, new: str, part: str, message: str) -> None:
    text = replaced(old, new, SNIPPET)
    path = snippet(tmp_path, text)
    read = deployment(tmp_path)
    with pytest.raises(DeploymentError) as caught:
        read_attach(path, read)
    expected = message.replace("DEPLOYMENT", str(read.path))
    assert str(caught.value).startswith(f"{path}:{line_of(part, text)}: {expected}")
    assert "\n" not in str(caught.value)


def test_an_override_that_a_value_came_from_is_named(tmp_path: Path) -> None:
    path = snippet(tmp_path)
    with pytest.raises(DeploymentError) as caught:
        read_attach(path, deployment(tmp_path, "context=2", "edges.left -> top.most.context=null"))
    assert str(caught.value) == (
        f"{path}:11: edges.left -> second.context.enabled: expected true or false, got 2 "
        "(from ${context}, --set context=2)"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "snippet.yaml: is empty; expected a map with nodes and edges"),
        ("[a]", "snippet.yaml:1: expected a map with nodes and edges, got a list"),
        ("nodes: {}", "snippet.yaml:1: nodes: expected at least one node"),
        ("edges: {}", "snippet.yaml:1: nodes: missing; expected by name"),
        ("nodes: {a: [", "snippet.yaml:1: no valid YAML"),
    ],
)
def test_what_is_no_snippet(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        read_attach(snippet(tmp_path, text), deployment(tmp_path))
    assert message in str(caught.value)


def test_what_is_not_there(tmp_path: Path) -> None:
    read = deployment(tmp_path)
    with pytest.raises(DeploymentError, match=r"^lefd: there is no such file, and .*; did you mean 'left'\?"):
        read_attach("lefd", read)
    with pytest.raises(DeploymentError, match="cannot be read: "):
        read_attach("x" * 10_000, read)
    with pytest.raises(DeploymentError, match="there is no such file"):
        read_replace(tmp_path / "nothing.yaml", "left", read)


def test_a_snippet_of_another_node_replaces_none(tmp_path: Path) -> None:
    path = snippet(tmp_path, ONE)
    with pytest.raises(DeploymentError) as caught:
        read_replace(path, "lift", deployment(tmp_path))
    what = "expected no other node than the one to be replaced, 'lift'"
    assert str(caught.value) == f"{path}:2: nodes.left: {what}"
