from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.loading.allowance import Refusals
from hierax.runtime.transport.launch_client import LaunchClient, is_gone
from hierax.runtime.transport.port import TransportError
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
        self._unread = Refusals()
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
    assert client.ask_nodes(status, {"look": "echo"}, status.nodes) == {"arm": {"process": "new", "x": 2}}


def test_a_node_that_answers_something_else_is_left_out_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    client = FakeClient(arm=[{"process": "new", "below": 5}], top=[{"process": "t", "below": ["arm"]}])
    for _ in range(3):
        assert client.edges(client.status()) == [("arm", "top")]
    assert caplog.messages == ["arm: left out, as its process gives answers that cannot be read"]


def test_what_is_of_another_shape_takes_no_answer_away() -> None:
    client = FakeClient(top=[{"process": "t", "below": ["arm"]}, {"process": "t", "below": 5}])
    assert client.edges(client.status()) == [("arm", "top")]


def test_a_roster_that_is_none_is_not_told(caplog: pytest.LogCaptureFixture) -> None:
    client = FakeClient(arm=[{"process": "new", "roster": 5}], top=[{"process": "t", "roster": None}])
    with pytest.raises(HieraxError, match="does not tell its roster"):
        client.roster(client.status())
    assert len(caplog.messages) == 1


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


def test_a_state_that_is_none() -> None:
    client = FakeClient(arm=[{"process": "new", "epoch": 3}])
    with pytest.raises(HieraxError, match=r"^arm: its process gave an answer that cannot be read$"):
        client.node_state(client.status(), "arm")


@pytest.mark.parametrize(("ps", "what"), [({"refusal": "no"}, "no"), ("hm", "no map: 'hm'"), ({}, "cannot be read")])
def test_a_launch_that_answers_something_else(ps: Any, what: str) -> None:
    with pytest.raises(HieraxError, match=what):
        FakeClient(ps).status()


def test_an_endpoint_where_nobody_listens_is_no_launch() -> None:
    endpoint = free_endpoint()
    assert is_gone(endpoint)
    assert not is_gone("tcp/not.a.host.invalid:7")


@pytest.mark.parametrize("endpoint", ["tcp/robot..local:7", f"tcp/{'a' * 64}.local:7", f"tcp/127.0.0.1:{'9' * 5000}"])
def test_what_can_be_no_address_cannot_be_reached(endpoint: str) -> None:
    assert not is_gone(endpoint)
    with pytest.raises(TransportError, match=r"cannot be reached: [^;]*$"):
        LaunchClient(endpoint, {"connect": {"timeout_ms": 100}})
