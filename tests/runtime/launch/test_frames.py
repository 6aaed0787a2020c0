"""Frames between a supervisor and its children."""

from __future__ import annotations

import random

import pytest

from hierax.runtime.launch.frames import BEGIN, Frames, NodeOrder, frame
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import ProbeSpec, Reference, Roster, RosterEdge


@pytest.mark.parametrize("seed", range(20))
def test_frames_come_out_as_they_went_in_however_they_are_cut(seed: int) -> None:
    rng = random.Random(seed)
    values = [{"number": n, "bytes": rng.randbytes(rng.randrange(300))} for n in range(20)]
    data = b"".join(map(frame, values))
    frames = Frames()
    came = []
    while data:
        cut = rng.randrange(1, 200)
        came += frames.feed(data[:cut])
        data = data[cut:]
    assert came == values


def test_a_frame_too_large_is_refused_before_it_is_read() -> None:
    with pytest.raises(SchemaError, match="a frame of 4294967295 bytes"):
        Frames().feed(b"\xff\xff\xff\xff")


def test_an_order_comes_out_as_it_went_in() -> None:
    edge = RosterEdge("w", "n", sense=Reference("m:f", {"size": 3}))
    roster = Roster("w", {"w": Reference("m:W"), "n": Reference("m:N", {"x": 0.5})}, (edge,), 4, {"w": 1, "n": 2})
    probes = (ProbeSpec("n", Reference("m:P", {"file": None})),)
    order = NodeOrder(
        name="n",
        process="p1",
        life=BEGIN,
        request="",
        deployment="d",
        run="r",
        roster=roster,
        modules=("m", "n.*"),
        preload=("m",),
        seed=7,
        epochs=None,
        staleness=None,
        rate_hz=2.5,
        hub="tcp/127.0.0.1:1",
        host="",
        settings={"mode": "peer"},
        low_latency=True,
        output="",
        probes=probes,
        import_paths=("a", "b"),
        checkpoint="c/n",
        durability="process",
        owner=OwnerPolicy(("m",), {"n": "stop"}, {"n": 2.0}, 3.0),
        on_uncertain_act="skip",
        processes={"w": "p0"},
    )
    (came,) = Frames().feed(frame(order.plain()))
    assert NodeOrder.read(came) == order
