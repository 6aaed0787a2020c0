"""A node's end of inspection and its client, through a hub, over Zenoh."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest
import zenoh
from support.live import until

from hierax.runtime.transport.control import QUESTIONS, InspectionEndpoint
from hierax.runtime.transport.hub import Hub, free_endpoint
from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import close_session, open_session
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value, decode_value, encode_value

KEYS = Keys("toys", "5163af85")


@pytest.fixture
def hub() -> Iterator[Hub]:
    hub = Hub(KEYS, None, None)
    yield hub
    hub.close()


@pytest.fixture
def session(hub: Hub) -> Iterator[zenoh.Session]:
    session = open_session(connect=[hub.endpoint], shared_memory=False)
    yield session
    close_session(session)


@pytest.fixture
def client(hub: Hub) -> Iterator[LaunchClient]:
    with LaunchClient(hub.endpoint, keys=KEYS) as client:
        yield client


class Answering:
    """Answers as nodes, in a thread of its own, until the block ends."""

    def __init__(self, *endpoints: InspectionEndpoint, answer: Callable[[Value], Value]) -> None:
        self._endpoints = endpoints
        self._answer = answer
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        while not self._done.wait(0.005):
            for endpoint in self._endpoints:
                for question, reply in endpoint.questions():
                    reply(self._answer(question))

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()


def test_nodes_answer_by_name(session: zenoh.Session, client: LaunchClient) -> None:
    endpoints = [InspectionEndpoint(session, KEYS, name) for name in ("arm", "top.most")]
    with Answering(*endpoints, answer=lambda question: {"echo": question}):
        answers = client.answers_of({"look": "meter"}, ["arm", "top.most"], timeout_s=10.0)
        assert answers == {name: [{"echo": {"look": "meter"}}] for name in ("arm", "top.most")}
        assert list(client.answers_of({"look": "meter"}, ["arm"], timeout_s=10.0)) == ["arm"]


def test_of_two_processes_both_answer(hub: Hub, session: zenoh.Session, client: LaunchClient) -> None:
    other = open_session(connect=[hub.endpoint], shared_memory=False)
    try:
        endpoints = [InspectionEndpoint(each, KEYS, "arm") for each in (session, other)]
        numbers = iter(range(1000))
        with Answering(*endpoints, answer=lambda question: next(numbers)):
            until(lambda: len(client.answers_of({}, ["arm"], timeout_s=5.0)["arm"]) == 2, "two answers")
    finally:
        close_session(other)


def test_who_does_not_answer_is_not_waited_for_long(session: zenoh.Session, client: LaunchClient) -> None:
    silent = InspectionEndpoint(session, KEYS, "arm")
    assert client.answers_of({}, ["arm", "nobody"], timeout_s=0.2) == {}
    assert list(silent.questions())


def test_waiting_questions_are_bounded(session: zenoh.Session, client: LaunchClient) -> None:
    endpoint = InspectionEndpoint(session, KEYS, "arm")
    until(lambda: client.answers_of(0, ["arm"], timeout_s=0.05) or list(endpoint.questions()), "the first question")
    for number in range(QUESTIONS + 10):
        client.answers_of(number, ["arm"], timeout_s=0.001)
    assert len(list(endpoint.questions())) <= QUESTIONS


def test_copies_are_shown_to_who_listens(session: zenoh.Session, client: LaunchClient) -> None:
    endpoint = InspectionEndpoint(session, KEYS, "arm")
    came: list[tuple[str, bytes]] = []
    client.listen(f"{KEYS.root}/seen/**", lambda key, data: came.append((key, data)))

    def show() -> bool:
        endpoint.show("obs", "arm", "top", b"bytes")
        return bool(came)

    until(show, "a copy")
    assert came[0] == (KEYS.seen("obs", "arm", "top"), b"bytes")


def test_the_supervisor_answers(hub: Hub, client: LaunchClient) -> None:
    hub.serve(lambda question, reply: reply({"asked": question}))
    assert client.ask({"ask": "ps"}) == {"asked": {"ask": "ps"}}


def test_what_cannot_be_reached_is_told() -> None:
    endpoint = free_endpoint()
    with pytest.raises(TransportError, match=f"the launch at {endpoint} cannot be reached"):
        LaunchClient(endpoint, {"connect": {"timeout_ms": 100}})


def test_what_is_no_key_is_told(client: LaunchClient) -> None:
    with pytest.raises(TransportError, match="is no key to listen to"):
        client.listen("a//b", lambda key, data: None)


def ask(endpoint: str, question: Value, keys: Keys | None = None) -> Value:
    with LaunchClient(endpoint, keys=keys) as client:
        return client.ask(question)


def supervises(hub: Hub, keys: Keys) -> None:
    hub.serve(lambda question, reply: reply({"hierarchy": keys.deployment, "run": keys.run, "asked": question}))


def test_the_run_is_found_out_where_nobody_says_which(hub: Hub) -> None:
    supervises(hub, KEYS)
    assert ask(hub.endpoint, {"ask": "anything"})["run"] == KEYS.run


def test_an_answer_counts_on_the_key_alone_on_which_it_was_asked_for(hub: Hub, session: zenoh.Session) -> None:
    """Somebody else answers sooner, to everything and on another key."""
    supervises(hub, KEYS)
    forged = {"hierarchy": "toys", "run": "ffffffff", "forged": True}

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply("hierax/toys/ffffffff/launch", encode_value(forged))

    strangers = session.declare_queryable("hierax/*/*/launch", answer)
    until(lambda: "forged" in next(iter(_answers(session)), {}), "the stranger's answer")
    assert "forged" not in ask(hub.endpoint, {"ask": "ps"}, keys=KEYS)
    with pytest.raises(TransportError, match=r"several launches answer at .*: 5163af85 \(toys\), ffffffff \(toys\)"):
        ask(hub.endpoint, {"ask": "ps"})
    strangers.undeclare()


def _answers(session: zenoh.Session) -> Iterator[Value]:
    for reply in session.get("hierax/toys/ffffffff/launch", timeout=1.0):
        if reply.ok is not None:
            yield decode_value(reply.ok.payload.to_bytes())


@pytest.mark.parametrize("question", [b"", b"\xc1", b"\x80" * 9, b"\xda\xff\xff" + bytes(1 << 20)])
def test_whatever_is_asked_is_refused_and_not_more(hub: Hub, session: zenoh.Session, question: bytes) -> None:
    supervises(hub, KEYS)
    InspectionEndpoint(session, KEYS, "arm")
    until(lambda: ask(hub.endpoint, {}, keys=KEYS), "the supervisor")
    replies = [reply.ok for reply in session.get(KEYS.launch, payload=question, timeout=5.0)]
    assert all("refusal" in decode_value(reply.payload.to_bytes()) for reply in replies if reply is not None)
