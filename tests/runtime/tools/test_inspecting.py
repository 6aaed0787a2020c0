from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, cast

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.tools.inspecting import LaunchInspector
from hierax.runtime.transport.inspection import LaunchClient
from hierax.schemas.keys import Keys

PS = {
    "hierarchy": "toys",
    "run": "5163af85",
    "epoch": 12,
    "roster": 1,
    "nodes": {"arm": {"process": "new", "state": "running"}, "top": {"process": "t", "state": "restarting"}},
}


class FakeGlass:
    """Answers as it is told to."""

    def __init__(self, ps: Any = PS, **answers: list[Any]) -> None:
        self.ps = ps
        self.answers = answers
        self.asked: list[tuple[Mapping[str, Any], list[str]]] = []

    def ask_keeper(self, question: Mapping[str, Any]) -> Any:
        return self.ps

    def ask_nodes(self, keys: Keys, question: Mapping[str, Any], names: Collection[str]) -> dict[str, list[Any]]:
        assert keys.root == "hierax/toys/5163af85"
        self.asked.append((question, sorted(names)))
        return {name: self.answers[name] for name in names if name in self.answers}


def looking(*arguments: Any, **answers: list[Any]) -> LaunchInspector:
    return LaunchInspector(cast(LaunchClient, FakeGlass(*arguments, **answers)))


def test_only_the_process_that_has_the_place_counts() -> None:
    through = looking(arm=[{"process": "old", "x": 1}, "nonsense", {"process": "new", "x": 2}], top=[{"process": "s"}])
    seen = through.look()
    assert through.ask(seen, {"look": "meter"}, seen.nodes) == {"arm": {"process": "new", "x": 2}}


def test_edges_are_put_together_from_what_nodes_say() -> None:
    through = looking(arm=[{"process": "new", "below": ["world"]}], top=[{"process": "t", "below": ["arm", "world"]}])
    assert through.pairs(through.look()) == [("arm", "top"), ("world", "arm"), ("world", "top")]


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("amr", "there is no node 'amr' in toys, run 5163af85; did you mean 'arm'?"),
        ("top", "top: its process does not answer; the launch says that it is restarting"),
        ("arm", "arm: still coming"),
    ],
)
def test_states_that_cannot_be_had(name: str, what: str) -> None:
    through = looking(arm=[{"process": "new", "refusal": "still coming"}])
    with pytest.raises(HieraxError) as caught:
        through.state(through.look(), name)
    assert str(caught.value) == what


@pytest.mark.parametrize(("ps", "what"), [({"refusal": "no"}, "no"), ("hm", "cannot be read"), ({}, "cannot be read")])
def test_a_launch_that_answers_something_else(ps: Any, what: str) -> None:
    with pytest.raises(HieraxError, match=what):
        looking(ps).look()
