"""The handshake: done on both sides exactly when every key has carried a greeting and its answer."""

from __future__ import annotations

import random

import pytest

from hierax.runtime.transport.rendezvous import Rendezvous
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, HELLO, OBSERVATIONS, TASKS, Header, Message

Greeting = tuple[str, Message]


def pair() -> dict[str, Rendezvous]:
    instances = {"low": 3, "up": 5}
    return {"low": Rendezvous("low", [], ["up"], instances, 2), "up": Rendezvous("up", ["low"], [], instances, 2)}


def hello(side: Rendezvous, peer: str) -> list[Greeting]:
    return side.handshakes[peer].hello(side.version)


def heard(side: Rendezvous, kind: str, message: Message) -> list[Greeting]:
    return side.handshakes[message.header.sender].heard(side.version, kind, message)


def shake(sides: dict[str, Rendezvous], loss: float, rng: random.Random, dead: frozenset[str] = frozenset()) -> int:
    """Greet, lose, answer, in any order, until both are done; how many rounds of greetings it took."""
    for rounds in range(1, 1000):
        under_way: list[Greeting] = []
        for name, peer in (("low", "up"), ("up", "low")):
            if sides[name].missing:
                under_way += hello(sides[name], peer)
        while under_way:
            kind, message = under_way.pop(rng.randrange(len(under_way)))
            if kind not in dead and rng.random() >= loss:
                under_way += heard(sides[message.header.receiver], kind, message)
        if sides["low"].ready and sides["up"].ready:
            return rounds
    return 0


@pytest.mark.parametrize("seed", range(50))
@pytest.mark.parametrize("loss", [0.0, 0.3, 0.7])
def test_both_sides_come_to_an_end(seed: int, loss: float) -> None:
    assert shake(pair(), loss, random.Random(seed)) >= 1


def test_without_loss_one_round_is_enough() -> None:
    assert shake(pair(), 0.0, random.Random(0)) == 1


@pytest.mark.parametrize("dead", [OBSERVATIONS, TASKS, CONTEXT])
def test_a_key_that_carries_nothing_is_noticed_on_both_sides(dead: str) -> None:
    sides = pair()
    assert shake(sides, 0.0, random.Random(0), frozenset({dead})) == 0
    assert sides["low"].missing == ("up",)
    assert sides["up"].missing == ("low",)


def test_a_greeting_of_another_instance_counts_for_nothing() -> None:
    sides = pair()
    kind, message = hello(sides["low"], "up")[0]
    assert heard(sides["up"], kind, Message(message.header._replace(instance=4), message.payload)) == []
    assert sides["up"].missing == ("low",)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("who", [["low"], ["up"], ["low", "up"]])
def test_a_link_that_broke_is_shaken_anew_on_both_sides_whoever_noticed(seed: int, who: list[str]) -> None:
    sides = pair()
    shake(sides, 0.0, random.Random(seed))
    others = {"low": "up", "up": "low"}
    old = [greeting for name, peer in others.items() for greeting in hello(sides[name], peer)]
    for name in who:
        sides[name].handshakes[others[name]].interrupted()
    for kind, message in old:  # what was under way counts for nothing
        if message.header.receiver in who:
            heard(sides[message.header.receiver], kind, message)
    assert all(sides[name].missing for name in who)
    assert shake(sides, 0.3, random.Random(seed))
    assert sides["low"].handshakes["up"].broken
    assert sides["up"].handshakes["low"].broken


@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_what_a_killed_process_had_heard_does_not_count_for_the_next_one(loss: float) -> None:
    sides = pair()
    shake(sides, 0.0, random.Random(0))
    sides["up"] = Rendezvous("up", ["low"], [], {"low": 3, "up": 5}, 2, process="another")
    for kind, message in hello(sides["low"], "up"):  # said to the one before
        heard(sides["up"], kind, message)
    assert sides["up"].missing == ("low",)
    assert shake(sides, loss, random.Random(1))
    assert sides["low"].handshakes["up"].peer_process == "another"
    assert sides["low"].handshakes["up"].broken, "what was sent to the one before is said again"


def test_versions_share_the_handshakes_of_the_same_processes() -> None:
    low = pair()["low"]
    later = Rendezvous("low", ["new"], ["up"], {"low": 3, "up": 5, "new": 7}, 7)
    later.take_over(low)
    assert later.handshakes["up"] is low.handshakes["up"]
    other = Rendezvous("low", [], ["up"], {"low": 3, "up": 6}, 8)
    other.take_over(low)
    assert other.handshakes["up"] is not low.handshakes["up"]


def test_what_is_no_greeting_is_refused() -> None:
    message = Message(Header(HELLO, "low", "up", 0, roster=2, instance=3), ({"heard": 1},))
    with pytest.raises(SchemaError, match="one map with"):
        heard(pair()["up"], OBSERVATIONS, message)


def test_a_greeting_on_a_key_on_which_nothing_comes_counts_for_nothing() -> None:
    sides = pair()
    message = hello(sides["low"], "up")[0][1]
    assert heard(sides["up"], TASKS, message) == []
    assert sides["up"].missing == ("low",)
