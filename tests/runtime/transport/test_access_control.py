"""Zenoh's lists, as they hold between sessions."""

from __future__ import annotations

import json
from collections.abc import Iterator
from secrets import token_hex
from typing import Any

import pytest
import zenoh
from support.live import until

from hierax.runtime.host.run_secret import issued, new_secret
from hierax.runtime.transport.access_control import access_control, launch_alone
from hierax.runtime.transport.zenoh_session import _configured, close_session, encrypted, free_endpoint, open_session
from hierax.schemas.access import LATER, LAUNCH, OPERATOR, READER, Access
from hierax.schemas.keys import Keys

ACCESS = Access("world", {name: (name,) for name in ("world", "low", "high")})


class Sessions:
    """Those of a run: a hub, and others that link to it."""

    def __init__(self) -> None:
        self.keys = Keys("roles", token_hex(4))
        self._secret = new_secret(authority=True)
        self._endpoint = free_endpoint(None, self._secret)
        self._opened: list[zenoh.Session] = []
        self.hub = self.open(LAUNCH, self._endpoint)

    def open(self, role: str, listen: str = "tls/127.0.0.1:0", access: Any = ACCESS) -> zenoh.Session:
        connect = [self._endpoint] if self._opened else []
        listed = access_control(self.keys, access) if isinstance(access, Access) else access
        secret = issued(self._secret, role, ["127.0.0.1"])
        session = open_session([listen], connect, None, False, secret=secret, access=listed)
        self._opened.append(session)
        return session

    def node(self, name: str) -> zenoh.Session:
        return self.open(ACCESS.role_of(name))

    def close(self) -> None:
        for session in reversed(self._opened):
            close_session(session)


@pytest.fixture
def sessions() -> Iterator[Sessions]:
    found = Sessions()
    yield found
    found.close()


def link(*found: zenoh.Session) -> None:
    """Wait until all are linked to all."""
    for one in found:
        others = {each.zid() for each in found} - {one.zid()}
        until(lambda one=one, others=others: others <= set(one.info.peers_zid()), "links")


def test_a_node_is_heard_on_its_keys_by_whom_they_lead_to(sessions: Sessions) -> None:
    low, high, reader = sessions.node("low"), sessions.node("high"), sessions.open(READER)
    keys, heard = sessions.keys, dict[str, list[str]]()
    for name, session, key in (("high", high, keys.inbox("high")), ("reader", reader, keys.everything)):
        got = heard[name] = []
        session.declare_subscriber(key, lambda sample, got=got: got.append(str(sample.key_expr)))
    link(sessions.hub, low, high, reader)
    own, others = keys.edge("obs", "low", "high"), [keys.edge("obs", "world", "high"), keys.edge("ctx", "low", "world")]

    def is_heard() -> bool:
        low.put(own, b"1")
        return own in heard["high"] and own in heard["reader"]

    until(is_heard, "what may be said")
    for key in (*others, own):
        low.put(key, b"1")
    until(lambda: others[1] in heard["reader"] and heard["reader"][-1] == own, "what comes last")
    assert {*heard["high"]} == {own}
    assert {*heard["reader"]} == {others[1], own}


def test_a_launch_is_asked_by_readers_for_changes_by_operators_alone(sessions: Sessions) -> None:
    keys, asked = sessions.keys, list[str]()
    for key in (keys.launch, keys.changes):

        def answer(query: zenoh.Query, key: str = key) -> None:
            asked.append(key)
            with query:
                query.reply(key, b"1")

        sessions.hub.declare_queryable(key, answer)
    reader, operator = sessions.open(READER), sessions.open(OPERATOR)
    for session, key, answers in (
        (reader, keys.launch, 1),
        (operator, keys.launch, 1),
        (operator, keys.changes, 1),
        (reader, keys.changes, 0),
    ):

        def said(session: zenoh.Session = session, key: str = key) -> int:
            return len([each for each in session.get(key, timeout=2.0) if each.ok])

        if answers:
            until(said, f"an answer on {key}")
        else:
            asked.clear()
            assert (said(), asked) == (0, [])


def test_a_later_node_is_seen_and_not_as_one_of_the_file(sessions: Sessions) -> None:
    low, later, tokens = sessions.node("low"), sessions.open(LATER), list[str]()
    keys = sessions.keys
    watching = low.liveliness().declare_subscriber(keys.alive("*"), lambda sample: tokens.append(str(sample.key_expr)))
    link(sessions.hub, low, later)
    claimed = [
        later.liveliness().declare_token(keys.alive(name, f"{name}~1")) for name in ("high", "world", "low", "new")
    ]
    until(lambda: tokens, "a sign of life")
    assert tokens == [keys.alive("new", "new~1")]
    assert claimed
    watching.undeclare()


def test_a_tool_hears_its_launch_alone(sessions: Sessions) -> None:
    tool, low, heard = sessions.open(READER, access=launch_alone()), sessions.node("low"), list[bytes]()
    keys = sessions.keys
    tool.declare_subscriber(keys.everything, lambda sample: heard.append(sample.payload.to_bytes()))
    link(sessions.hub, tool, low)
    publisher = sessions.hub.declare_publisher(keys.notes)
    until(lambda: publisher.matching_status.matching, "the tool")
    low.put(keys.edge("obs", "low", "high"), b"low")
    publisher.put(b"hub")
    until(lambda: heard, "the launch")
    assert heard == [b"hub"]


def test_who_has_certificates_of_its_own_is_held_to_no_list_of_ours() -> None:
    ours = encrypted(issued(new_secret(authority=True), LAUNCH), access_control(Keys("a", "b"), ACCESS))
    own = {"transport": {"link": {"tls": {"enable_mtls": False}}}}
    for settings, listed in ((None, "true"), (own, "false")):
        assert _configured(ours, settings).get_json("access_control/enabled") == listed


def test_a_list_grows_with_the_nodes_and_not_with_their_pairs() -> None:
    def size(count: int) -> int:
        names = [f"n{number}" for number in range(count)]
        return len(json.dumps(access_control(Keys("a", "b"), Access("n0", {name: (name,) for name in names}))))

    assert size(400) < 1.1 * 2 * size(200)


def test_a_hierarchy_of_the_world_alone_has_a_list() -> None:
    assert access_control(Keys("a", "b"), Access("w", {"w": ("w",)}))["default_permission"] == "deny"
