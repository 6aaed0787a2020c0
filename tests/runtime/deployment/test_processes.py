"""Which nodes share a process: as the file says, and as a hierarchy is cut."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.deployments import TOYS, replaced, write

from hierax.runtime.deployment.deployment import DeploymentError
from hierax.runtime.deployment.partition import cut
from hierax.runtime.deployment.read import read_deployment
from hierax.schemas.roster import Reference, Roster, RosterEdge

NODE = Reference("toys:Node")


def processes(folder: Path, said: str) -> dict[str, tuple[str, ...]]:
    return dict(read_deployment(write(folder, replaced("nodes:\n", f"processes: {said}\nnodes:\n"))).processes)


def test_nodes_are_named_or_are_like_a_name(tmp_path: Path) -> None:
    assert processes(tmp_path, '{low: [world, "l*"]}') == {"low": ("world", "left")}
    assert processes(tmp_path, '{left: ["*"]}') == {"left": ("left", "top.most", "world")}
    assert processes(tmp_path, "{one: [left, left], two: [world]}") == {"one": ("left",), "two": ("world",)}
    assert processes(tmp_path, "null") == {}
    assert read_deployment(write(tmp_path)).processes == {}


FAULTS = {
    "{low: [world, lefd]}": "processes.low[1]: there is no node 'lefd'; did you mean 'left'?",
    '{low: ["x*"]}': "processes.low[0]: there is no node like 'x*'; the nodes are world, left, top.most",
    "{low: [world], high: [left, world]}": "processes.high[1]: 'world' is in process 'low' already; a node is in one",
    "{low: []}": "processes.low: is empty; expected names of nodes",
    "{left: [world]}": "processes.left: a node of this name is in another process; expected another name, or 'left'",
    "{world: [left], low: [world]}": "processes.world: a node of this name is in another process",
    "{low: world}": "processes.low: expected a list",
    "{low: [3]}": "processes.low[0]: expected text",
    '{"a/b": [world]}': "processes.a/b: ",
    "[world]": "processes: expected a map",
}


@pytest.mark.parametrize(("said", "what"), FAULTS.items())
def test_what_is_wrong_is_told_in_a_line(said: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(DeploymentError) as raised:
        processes(tmp_path, said)
    text = str(raised.value)
    line = TOYS[: TOYS.index("nodes:\n")].count("\n") + 1
    assert text.startswith(f"{tmp_path / 'toys.yaml'}:{line}: {what}"), text
    assert "\n" not in text


def hierarchy(pairs: list[tuple[str, str]]) -> Roster:
    nodes = dict.fromkeys(["world", *(upper for _, upper in pairs)], NODE)
    return Roster("world", nodes, tuple(RosterEdge(*pair) for pair in sorted(pairs)))


CHAIN = [("world", "a"), ("a", "b"), ("b", "c"), ("c", "d")]


def test_a_chain_is_cut_into_neighbours() -> None:
    assert cut(hierarchy(CHAIN), 2) == {"process1": ("a", "world"), "process2": ("b", "c", "d")}
    assert cut(hierarchy(CHAIN), 1) == {"process1": ("a", "b", "c", "d", "world")}
    assert len(cut(hierarchy(CHAIN), 9)) == 5


def test_the_fewest_bytes_are_between_processes() -> None:
    traffic = {("world", "a"): 1e6, ("a", "b"): 10.0, ("b", "c"): 1e3, ("c", "d"): 20.0}
    assert set(cut(hierarchy(CHAIN), 3, traffic).values()) == {("a", "world"), ("b", "c"), ("d",)}
    assert set(cut(hierarchy(CHAIN), 2, traffic).values()) == {("a", "world"), ("b", "c", "d")}


def test_a_process_is_named_as_no_node_is() -> None:
    assert set(cut(hierarchy([("world", "process1")]), 2)) == {"process-1", "process-2"}


@given(st.data())
def test_each_node_is_in_one_process(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 12))
    names = [f"n{number}" for number in range(count)]
    pairs = []
    for place, name in enumerate(names):
        lowers = data.draw(st.sets(st.sampled_from(["world", *names[:place]]), min_size=1, max_size=3))
        pairs += [(lower, name) for lower in lowers]
    traffic = data.draw(st.none() | st.fixed_dictionaries({pair: st.floats(0, 1e9) for pair in pairs}))
    wanted = data.draw(st.integers(1, count + 3))
    found = cut(hierarchy(pairs), wanted, traffic)
    assert sorted(node for nodes in found.values() for node in nodes) == sorted(["world", *names])
    assert len(found) == min(wanted, count + 1)
    sizes = [len(nodes) for nodes in found.values()]
    assert traffic is not None or max(sizes) - min(sizes) <= 1
