from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.deployments import TOYS, write

from hierax.runtime.commands.main import main


def test_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", str(write(tmp_path))]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["toys:", "a", "counter", "and", "two", "that", "sum"] in lines
    assert ["world", "support.toy_nodes:Counter", "left,", "top.most", "0"] in lines
    assert ["left", "support.toy_nodes:Summer", "world", "top.most", "1"] in lines
    assert ["top.most", "support.toy_nodes:Summer", "left,", "world", "2"] in lines
    assert ["left", "->", "top.most", "support.toy_nodes:seen", "support.toy_nodes:Scale"] in lines


def test_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", str(write(tmp_path)), "--format", "json", "--set", "context=false"]) == 0
    graph = json.loads(capsys.readouterr().out)
    assert (graph["hierarchy"], graph["world"], len(graph["edges"])) == ("toys", "world", 3)
    assert graph["nodes"]["top.most"] == {
        "class": "support.toy_nodes:Summer",
        "below": ["left", "world"],
        "above": [],
        "depth": 2,
    }
    assert graph["edges"][0] == {
        "lower": "left",
        "upper": "top.most",
        "sense": "support.toy_nodes:seen",
        "task": None,
        "context": None,
    }


def test_as_mermaid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = TOYS.replace("    task: null", "    task: support.toy_nodes:wanted")
    assert main(["graph", str(write(tmp_path, text)), "--format", "mermaid"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "flowchart BT",
        '    n0[("world")]',
        '    n1["left"]',
        '    n2["top.most"]',
        "    n1 -->|seen| n2",
        "    n2 -.->|task: wanted| n1",
        "    n2 -.->|context: Scale| n1",
        "    n0 -->|seen| n1",
        "    n0 -->|seen| n2",
    ]


RATES = ["--set", "nodes.left.every=4", "--set", "nodes.left.offset=3", "--set", "nodes.top.most.every=2"]
RATES += ["--set", "edges.left -> top.most.delay=5", "--set", "edges.world -> left.gather=true"]


def test_rates_are_shown_where_there_are_some(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def shown(kind: str) -> str:
        assert main(["graph", str(write(tmp_path)), "--format", kind, *RATES]) == 0
        return capsys.readouterr().out

    lines = [line.split() for line in shown("text").splitlines()]
    assert ["left", "support.toy_nodes:Summer", "world", "top.most", "1", "4", "3"] in lines
    assert ["world", "->", "left", "support.toy_nodes:seen", "yes"] in lines
    assert ["left", "->", "top.most", "support.toy_nodes:seen", "support.toy_nodes:Scale", "5"] in lines
    graph = json.loads(shown("json"))
    assert [graph["nodes"]["left"][key] for key in ("every", "offset")] == [4, 3]
    assert graph["nodes"]["top.most"]["every"] == 2
    assert "every" not in graph["nodes"]["world"]
    rates = {f"{edge['lower']} -> {edge['upper']}": (edge.get("delay"), edge.get("gather")) for edge in graph["edges"]}
    assert rates == {"left -> top.most": (5, None), "world -> left": (None, True), "world -> top.most": (None, None)}
    drawn = shown("mermaid").splitlines()
    assert '    n1["left<br>every 4<br>offset 3"]' in drawn
    assert "    n2 -.->|context: Scale, delay 5| n1" in drawn
    assert "    n0 -->|seen, gather| n1" in drawn


def test_an_edge_without_sensing_is_drawn_all_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = TOYS.replace("  world -> left:\n    sense: support.toy_nodes:seen\n", "  world -> left: {}\n")
    assert main(["graph", str(write(tmp_path, text)), "--format", "mermaid"]) == 0
    assert "    n0 --> n1" in capsys.readouterr().out.splitlines()


def test_no_class_is_loaded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", str(write(tmp_path)), "--set", "nodes.left.class=not_there:X"]) == 0
    assert "not_there:X" in capsys.readouterr().out


def test_a_description_stays_in_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", str(write(tmp_path)), "--set", r'description="\e[2Jone\ntwo:"']) == 0
    assert capsys.readouterr().out.splitlines()[0] == r"toys: \x1b[2Jone\ntwo:"


def test_a_world_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, "hierarchy: one\nworld: w\nnodes:\n  w: {class: a:b}\n")
    assert main(["graph", str(path)]) == 0
    assert capsys.readouterr().out.startswith("one\n")
