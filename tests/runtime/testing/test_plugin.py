"""The fixtures, which every pytest in this environment has."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from support.deployments import write
from support.hierarchies import random_hierarchy

from hierax.runtime import Elements, Node, Value, World
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.hierarchy import Edge
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.testing.runs import Ran, Recorded
from hierax.schemas.values import encode_value


class Clock(World):
    """Counts."""

    def initial_belief(self) -> Value:
        return 0

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + 1 + sum(context)

    def finished(self, belief: Value) -> bool:
        return bool(belief >= 100)


class Follower(Node):
    """Believes what it sees last."""

    def initial_belief(self) -> Value:
        return -1

    def observe(self, observations: Elements, belief: Value) -> Value:
        return observations[-1] if observations else belief


def seen(belief: Value) -> Elements:
    return (belief,)


def test_pytest_finds_the_plugin() -> None:
    (found,) = entry_points(group="pytest11", name="hierax")
    assert found.value == "hierax.runtime.testing.plugin"


def test_the_plugin_imports_nothing_heavy() -> None:
    heavy = ("numpy", "zenoh", "anyio", "pydantic", "rich", "cv2", "msgpack")
    script = (
        "import sys, pytest; before = set(sys.modules); import hierax.runtime.testing.plugin; "
        f"print(sorted((set(sys.modules) - before) & set({heavy!r})), len(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    found, count = done.stdout.rsplit(" ", 1)
    assert found == "[]"
    assert int(count) < 20


def test_a_deployment_file(hierax_run: Callable[..., Ran], tmp_path: Path) -> None:
    ran = hierax_run(write(tmp_path), epochs=4, seed=3, set={"step": 5})
    assert ran.beliefs["world"] == 20
    assert ran.history("world") == [5, 10, 15, 20]
    assert ran.metrics["world"] == {"count": 20.0}
    assert len(ran.digests) == 4
    assert ran.digests[-1] == ran.digest
    assert [step.observations for step in ran.steps["left"]] == [(0.0,), (5.0,), (10.0,), (15.0,)]
    assert hierax_run(write(tmp_path), epochs=4, seed=3, set={"step": 5}).digests == ran.digests


WORLD_OF_VALUES = """hierarchy: told
world: world
parameters: {value: null}
nodes:
  world: {class: "valued:Told", parameters: {value: "${value}"}}
edges: {}
"""
VALUED = """from hierax.runtime import World


class Told(World):
    def __init__(self, value):
        self.value = value

    def initial_belief(self):
        return {"value": self.value}
"""


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("\U0001f600 no: [1", None),
        ("yes", None),
        (np.int64(3), 3),
        (np.float32(0.5), 0.5),
        (-math.inf, None),
        ({"a": [1e-12, math.inf]}, {"a": (1e-12, math.inf)}),
        (np.array([[1.0, 2.0]]), ((1.0, 2.0),)),
        ((True, None), (True, None)),
    ],
)
def test_values_arrive_as_they_are_given(
    hierax_run: Callable[..., Ran], tmp_path: Path, value: object, told: object
) -> None:
    (tmp_path / "valued.py").write_text(VALUED)
    (tmp_path / "told.yaml").write_text(WORLD_OF_VALUES)
    found = hierax_run(tmp_path / "told.yaml", epochs=1, set={"value": value}).beliefs["world"]["value"]
    assert found == (value if told is None else told)


def test_a_value_that_no_file_has_is_refused(hierax_run: Callable[..., Ran], tmp_path: Path) -> None:
    with pytest.raises(HieraxError, match=r"set step: expected text, numbers, lists or maps, got <object"):
        hierax_run(write(tmp_path), epochs=1, set={"step": object()})


def test_a_shipped_deployment(hierax_run: Callable[..., Ran]) -> None:
    beliefs = hierax_run("letters").beliefs
    assert beliefs["word"]["posterior"] == {"THE": 0.0, "CAT": 1.0}


def test_nodes_that_the_test_has_made(hierax_run: Callable[..., Ran]) -> None:
    edge = Edge("world", "eye", sense=seen, context=lambda belief: (belief,))
    ran = hierax_run(nodes={"world": Clock(), "eye": Follower()}, edges=[edge], epochs=5)
    assert ran.history("eye") == [0, 1, 3, 7, 15]
    assert ran.report.epochs == 5
    assert hierax_run(nodes={"world": Clock(), "eye": Follower()}, edges=[edge], epochs=50).report.epochs == 7


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_run_is_what_the_formal_core_says(hierax_run: Callable[..., Ran], seed: int) -> None:
    hierarchy = random_hierarchy(seed, nodes=5, setting=OperatorSetting(seed))
    ran = hierax_run(nodes=hierarchy.nodes, edges=hierarchy.edges, world=hierarchy.world, epochs=3, seed=seed)
    active = ActiveHierarchy.initial(hierarchy)
    for epoch in range(3):
        active = update(active)
        for name, state in active.states.items():
            assert encode_value(ran.history(name)[epoch]) == encode_value(state.belief), (name, epoch)


def test_one_node(hierax_node: Callable[..., list[Step]]) -> None:
    steps = hierax_node(Follower(), observations=[(1,), (), (2, 3)])
    assert [step.belief for step in steps] == [1, 1, 3]


def test_either_a_file_or_nodes(hierax_run: Callable[..., Ran]) -> None:
    for arguments in ({}, {"deployment": "letters", "nodes": {}}):
        with pytest.raises(TypeError, match="expected a deployment or nodes, one of them"):
            hierax_run(**arguments)


@pytest.mark.parametrize(
    "more", [{"nodes": {"world": Clock()}, "set": {"step": 5}}, {"edges": [Edge("world", "eye")]}, {"world": "eye"}]
)
def test_what_would_be_left_out_is_refused(more: dict[str, object], hierax_run: Callable[..., Ran]) -> None:
    with pytest.raises(TypeError, match=r"hierax_run: (set changes a deployment|edges and world go with nodes)"):
        hierax_run(*(() if "nodes" in more else ("letters",)), **more)


@pytest.mark.parametrize("epochs", [0, -1])
def test_a_test_of_no_epoch_fails(
    epochs: int,
    hierax_run: Callable[..., Ran],
    hierax_node: Callable[..., list[Step]],
    hierax_recorded: Callable[..., Recorded],
) -> None:
    runs = (partial(hierax_run, "letters"), partial(hierax_run, nodes={"world": Clock()}))
    for run in (*runs, partial(hierax_node, Follower()), partial(hierax_recorded, "any.mcap", "node")):
        with pytest.raises(HieraxError, match=f"epochs: expected a whole number from 1 on, got {epochs}"):
            run(epochs=epochs)


def test_what_is_wrong_with_a_file_is_told(hierax_run: Callable[..., Ran]) -> None:
    with pytest.raises(HieraxError, match="did you mean 'letters'"):
        hierax_run("leters")
