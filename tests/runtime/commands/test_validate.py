from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.deployments import TOYS, line_of, replaced, write

from hierax.runtime.commands.main import main
from hierax.runtime.deployment.read import read_deployment


def test_a_right_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path)
    content = read_deployment(path).roster.content_hash().hex()
    assert main(["validate", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: OK, 3 nodes, 3 edges, content {content}\n"


def test_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path)
    content = read_deployment(path, ["step=3"]).roster.content_hash().hex()
    assert main(["validate", str(path), "--set", "step=3", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "hierarchy": "toys",
        "file": str(path),
        "nodes": 3,
        "edges": 3,
        "content": content,
    }


def test_a_node_beside_the_file_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module = "from support.toy_nodes import Summer\nclass Mine(Summer):\n    pass\n"
    (tmp_path / "hierax_test_beside.py").write_text(module)
    path = write(tmp_path)
    assert main(["validate", str(path), "--set", "nodes.left.class=hierax_test_beside:Mine"]) == 0
    assert "OK" in capsys.readouterr().out


def test_async_operators_are_waited_for(tmp_path: Path) -> None:
    assert main(["validate", str(write(tmp_path)), "--set", "nodes.left.class=support.toy_nodes:Waiting"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "part", "message"),
    [
        ("toy_nodes:Counter", "toy_nodes:Countre", "    class", "nodes.world.class: there is no 'Countre' in module"),
        (
            '{step: "${step}"}',
            "{stap: 2}",
            "{stap",
            "nodes.world.parameters.stap: support.toy_nodes:Counter has no such",
        ),
        (
            "{class: support.toy_nodes:Summer}",
            '{class: "support.toy_nodes:Faulty"}',
            "  left:",
            "nodes.left: initial_belief",
        ),
        (
            "{class: support.toy_nodes:Summer}",
            '{class: "support.toy_nodes:Misshapen"}',
            "  left:",
            "nodes.left: observe must",
        ),
        (
            "toy_nodes:Keeper",
            "toy_nodes:Summer",
            "    class: support.toy_nodes:Summer\n    parameters: {file",
            "probes[0].class: expected a class derived from Probe, but support.toy_nodes:Summer is a Node",
        ),
        (
            "hierarchy: toys",
            "view: {show: 'support.toy_nodes:nothing'}\nhierarchy: toys",
            "view:",
            "view.show: there is no 'nothing' in module",
        ),
    ],
)
def test_what_is_wrong_has_its_line(
    tmp_path: Path, old: str, new: str, part: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = replaced(old, new)
    path = write(tmp_path, text)
    assert main(["validate", str(path)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"error: {path}:{line_of(part, text)}: {message}")
    assert err.count("\n") == 1


@pytest.mark.parametrize("command", ["validate", "launch"])
@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("{foo: 1}", "zenoh: Zenoh: "),
        (r'"\0"', "zenoh: there is no file "),
        ("{transport: {link: {rx: {max_message_size: abc}}}}", "zenoh.transport.link.rx.max_message_size"),
        ("{transport: {unicast: {lowlatency: true}}}", "zenoh: Zenoh's settings have transport/unicast/lowlatency"),
    ],
)
def test_settings_that_zenoh_refuses_have_their_line(
    command: str, setting: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"{TOYS}\nzenoh: {setting}\n"
    path = write(tmp_path, text)
    assert main([command, str(path)]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"error: {path}:{line_of('zenoh:', text)}: {told.partition('.')[0]}")
    assert err.count("\n") == 1
    assert main([command, str(write(tmp_path)), "--set", f"zenoh={setting}"]) == 1
    assert "zenoh: " in capsys.readouterr().err


def test_settings_that_zenoh_takes_are_fine(tmp_path: Path) -> None:
    assert main(["validate", str(write(tmp_path, f"{TOYS}\nzenoh: {{scouting: {{delay: 7}}}}\n"))]) == 0
