from __future__ import annotations

from typing import Any

import pytest
from support.deployments import TOYS

from hierax.runtime.deployment.deployment import DeploymentError, Document
from hierax.runtime.deployment.parameters import apply_override
from hierax.runtime.deployment.tree import read_tree


def document(text: str = TOYS) -> Document:
    tree = read_tree(text, "toys.yaml")
    return Document("toys.yaml", tree.value, tree.lines)


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("step=5", ["parameters", "step"], 5),
        (" step = 5", ["parameters", "step"], 5),
        ("parameters.step=5", ["parameters", "step"], 5),
        ("step=", ["parameters", "step"], None),
        ("step=a=b", ["parameters", "step"], "a=b"),
        ("scale=[1e-3, {a: 1}]", ["parameters", "scale"], [0.001, {"a": 1}]),
        ("epochs=7", ["epochs"], 7),
        ("start_timeout_s=1.5", ["start_timeout_s"], 1.5),
        ("restart.max_restarts=0", ["restart", "max_restarts"], 0),
        ("nodes.left.restart_policy=never", ["nodes", "left", "restart_policy"], "never"),
        ("nodes.world.class=a:b", ["nodes", "world", "class"], "a:b"),
        ("nodes.world.parameters.last=9", ["nodes", "world", "parameters", "last"], 9),
        ("nodes.left.parameters.scale=9", ["nodes", "left", "parameters", "scale"], 9),
        ("nodes.top.most.parameters.weights[1]=3", ["nodes", "top.most", "parameters", "weights", 1], 3),
        ("nodes.top.most.parameters.weights.0=3", ["nodes", "top.most", "parameters", "weights", 0], 3),
        ("nodes.left.parameters.a.b=3", ["nodes", "left", "parameters", "a", "b"], 3),
        ("nodes.left={class: a:b}", ["nodes", "left"], {"class": "a:b"}),
        ("edges.left->top.most.context=null", ["edges", "left -> top.most", "context"], None),
        (
            "edges.left -> top.most.sense.enabled=false",
            ["edges", "left -> top.most", "sense"],
            {"function": "support.toy_nodes:seen", "enabled": False},
        ),
        ("edges.left -> top.most.task.function=a:b", ["edges", "left -> top.most", "task"], {"function": "a:b"}),
        ("probes[0].node=world", ["probes", 0, "node"], "world"),
        ("zenoh.listen.endpoints=[x]", ["zenoh"], {"listen": {"endpoints": ["x"]}}),
    ],
)
def test_one_value_is_changed(override: str, path: list[str | int], value: object) -> None:
    changed = document()
    apply_override(changed, override)
    found: Any = changed.root
    for key in path:
        found = found[key]
    assert found == value
    assert list(changed.changed.values()) == [override]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("step", "--set step: expected PATH=VALUE, e.g. noise=0.1"),
        ("=3", "--set =3: expected PATH=VALUE"),
        ("steep=3", "--set steep=3: there is no 'steep'; did you mean 'step'?"),
        ("epoch=3", "--set epoch=3: there is no 'epoch'; did you mean 'epochs'?"),
        ("parameters.steep=3", "there is no 'steep' in parameters; did you mean 'step'?"),
        ("nodes.wrld.class=3", "there is no 'wrld' in nodes; did you mean 'world'?"),
        ("nodes.world.clas=3", "there is no 'clas' in nodes.world; did you mean 'class'?"),
        (
            "nodes.world.step=3",
            "there is no 'step' in nodes.world; expected one of budget_ms, class, every, max_restart_delay, ",
        ),
        ("nodes.world.max_restart=3", "there is no 'max_restart' in nodes.world; did you mean 'max_restarts'?"),
        ("nodes.world.scheduling.polcy=fifo", "no 'polcy' in nodes.world.scheduling; did you mean 'policy'?"),
        ("restart.max_restart=3", "there is no 'max_restart' in restart; did you mean 'max_restarts'?"),
        ("edges.left -> top=3", "there is no 'left -> top' in edges; did you mean 'left -> top.most'?"),
        ("edges.left -> top.most.contxt=3", "there is no 'contxt' in edges.left -> top.most; did you mean 'context'?"),
        ("edges.left -> top.most.sense.function.x=3", "edges.left -> top.most.sense.function is no map"),
        ("probes.1.node=world", "--set probes.1.node=world: probes has 1 item, counted from 0"),
        ("probes.x=world", "probes has 1 item, counted from 0"),
        ("epochs.x=3", "--set epochs.x=3: epochs is no map, nothing is inside it"),
        ("nodes.world.class.x=3", "nodes.world.class is no map, nothing is inside it"),
        ("step=[1", "--set step=[1: no valid YAML"),
        ("step={a: 1, a: 2}", "--set step={a: 1, a: 2}: a: given twice"),
    ],
)
def test_what_is_refused(override: str, message: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        apply_override(document(), override)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"--set {override}: ")


def test_the_last_one_wins() -> None:
    changed = document()
    for override in ("nodes.left.parameters.scale=1", "nodes.left={class: a:b}", "nodes.left.class=c:d"):
        apply_override(changed, override)
    assert changed.root["nodes"]["left"] == {"class": "c:d"}
    assert changed.changed == {
        ("nodes", "left"): "nodes.left={class: a:b}",
        ("nodes", "left", "class"): "nodes.left.class=c:d",
    }


@pytest.mark.parametrize(
    "text", ["nodes: 3\nparameters: [1]\nedges: x", "a: 1", "nodes:\nparameters:\nedges:\nprobes:"]
)
@pytest.mark.parametrize("override", ["step=1", "nodes.a.class=1", "edges.a -> b.sense=1", "probes.0=1"])
def test_a_broken_file_is_no_reason_to_crash(text: str, override: str) -> None:
    with pytest.raises(DeploymentError):
        apply_override(document(text), override)


def test_a_path_may_go_on_inside_a_parameter() -> None:
    changed = document("parameters: {draw: {sets: 3}}\n")
    apply_override(changed, "draw.sets=5")
    assert changed.root["parameters"] == {"draw": {"sets": 5}}
