from __future__ import annotations

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.tools.echoes import Counter, chosen, edge_of, edges_of, message_of, short_key
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.messages import OBSERVATIONS, Header, Message, encode_message

EDGES = edges_of([("world", "arm"), ("arm", "spatial")])


def test_an_edge_has_three_keys() -> None:
    assert [short_key(edge) for edge in EDGES] == [
        "ctx/arm/world",
        "ctx/spatial/arm",
        "obs/arm/spatial",
        "obs/world/arm",
        "task/arm/world",
        "task/spatial/arm",
    ]


@pytest.mark.parametrize(
    ("pattern", "count"),
    [
        ("obs/world/arm", 1),
        ("obs/*/*", 2),
        ("**", 6),
        ("ctx/**", 2),
        ("ctx/spatial/**", 1),
        ("*/arm/*", 3),
        ("hierax/tracking/5163af85/obs/world/arm", 1),
        ("*/*/s?atial", 1),
    ],
)
def test_patterns(pattern: str, count: int) -> None:
    assert len(chosen(pattern, EDGES)) == count


@pytest.mark.parametrize("pattern", ["obs/world/amr", "obs", "", "obs/world/arm/more", "**/arm"])
def test_what_fits_nothing_is_told(pattern: str) -> None:
    with pytest.raises(HieraxError, match="no key fits"):
        chosen(pattern, EDGES)
    with pytest.raises(HieraxError, match="did you mean 'obs/world/arm'"):
        chosen("obs/world/amr", EDGES)


def test_a_message_is_of_the_edge_where_it_is_shown_or_none() -> None:
    message = Message(Header(OBSERVATIONS, "world", "arm", 3), ("x",))
    edge = edge_of(Keys("tracking", "5163af85").seen(*message.header.line))
    assert message_of(edge, encode_message(message)) == message
    for header in (message.header._replace(sender="arm"), message.header._replace(kind="ctx")):
        with pytest.raises(SchemaError, match=r"expected what its key names, got '(obs/arm/arm|ctx/world/arm)'"):
            message_of(edge, encode_message(Message(header, ("x",))))
    with pytest.raises(SchemaError, match="does not begin like a message"):
        message_of(edge, b"\x80")


def test_rates_and_gaps_are_those_of_each_key() -> None:
    now = 0.0
    counter = Counter(lambda: now)

    def take(epoch: int, sender: str = "arm") -> tuple[float | None, int]:
        echo = counter.take(Message(Header(OBSERVATIONS, sender, "top", epoch), ()), 50)
        return echo.rate_hz, echo.missed

    assert take(7) == (None, 0)
    now = 0.5
    assert take(8) == (2.0, 0)
    assert take(1, "other") == (None, 0)
    now = 1.5
    assert take(12) == (pytest.approx(2 / 1.5), 3)
    now = 2.0
    assert take(12) == (1.5, 0)  # another attempt
    for _ in range(500):
        now += 0.01
        take(13)
    assert counter.take(Message(Header(OBSERVATIONS, "arm", "top", 14), ()), 50).rate_hz == pytest.approx(101, rel=0.05)
