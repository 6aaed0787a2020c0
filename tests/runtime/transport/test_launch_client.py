from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.transport.launch_client import LaunchClient, is_gone
from hierax.runtime.transport.zenoh_session import free_endpoint
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

PS = {
    "hierarchy": "toys",
    "run": "5163af85",
    "epoch": 12,
    "roster": 1,
    "nodes": {"arm": {"process": "new", "state": "running"}, "top": {"process": "t", "state": "restarting"}},
}


class FakeClient(LaunchClient):
    """A launch answers as it is told to."""

    def __init__(self, ps: Any = PS, **answers: list[Any]) -> None:
        self.endpoint = "tcp/127.0.0.1:1"
        self._keys = Keys("toys", "5163af85")
        self._ps = ps
        self._told = answers

    def _get(self, key: str, question: Value, timeout_s: float) -> Iterator[tuple[str, Value]]:
        assert key.startswith("hierax/toys/5163af85/")
        if key == self.keys().launch:
            yield key, self._ps
            return
        for name, answers in self._told.items():
            for answer in answers:
                yield self.keys().look(name), answer


def test_only_the_process_that_has_the_place_counts() -> None:
    client = FakeClient(
        arm=[{"process": "old", "x": 1}, "nonsense", {"process": "new", "x": 2}], top=[{"process": "s"}]
    )
    status = client.status()
    assert client.ask_nodes(status, {"look": "meter"}, status.nodes) == {"arm": {"process": "new", "x": 2}}


def test_edges_are_put_together_from_what_nodes_say() -> None:
    client = FakeClient(arm=[{"process": "new", "below": ["world"]}], top=[{"process": "t", "below": ["arm", "world"]}])
    assert client.edges(client.status()) == [("arm", "top"), ("world", "arm"), ("world", "top")]


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("amr", "there is no node 'amr' in toys, run 5163af85; did you mean 'arm'?"),
        ("top", "top: its process does not answer; the launch says that it is restarting"),
        ("arm", "arm: still coming"),
    ],
)
def test_states_that_cannot_be_had(name: str, what: str) -> None:
    client = FakeClient(arm=[{"process": "new", "refusal": "still coming"}], top=["of nobody"])
    with pytest.raises(HieraxError) as caught:
        client.node_state(client.status(), name)
    assert str(caught.value) == what


@pytest.mark.parametrize(("ps", "what"), [({"refusal": "no"}, "no"), ("hm", "no map: 'hm'"), ({}, "cannot be read")])
def test_a_launch_that_answers_something_else(ps: Any, what: str) -> None:
    with pytest.raises(HieraxError, match=what):
        FakeClient(ps).status()


def test_an_endpoint_where_nobody_listens_is_no_launch() -> None:
    endpoint = free_endpoint()
    assert is_gone(endpoint)
    assert not is_gone("tcp/not.a.host.invalid:7")
