"""Checkpoints and the world's record as bytes, and what is said of bytes that are none."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.strategies import randoms, unsigned, values

from hierax.runtime.core.digest import encode_state
from hierax.schemas.checkpoint import (
    Checkpoint,
    WorldRecord,
    decode_checkpoint,
    decode_roster,
    decode_state,
    decode_under_way,
    decode_world,
    encode_checkpoint,
    encode_trial,
    encode_under_way,
    encode_world,
)
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.messages import Header, Message, encode_message
from hierax.schemas.roster import Reference, Roster, RosterEdge
from hierax.schemas.values import encode_value

TOO_LARGE = 1 << 64
START = encode_state({"lost": False}, "wait", ())
NOW = encode_state({"lost": True}, "follow", (0.5,))
ROSTER = Roster(
    world="world",
    nodes={"world": Reference("package.module:World"), "arm": Reference("package.module:Arm")},
    edges=(RosterEdge("world", "arm", sense=Reference("package.module:seen")),),
    version=3,
    instances={"world": 1, "arm": 2},
)
CHECKPOINT = Checkpoint(epoch=7, attempt=1, instance=2, roster=3, finished=True, start=START, now=NOW)
WORLD = WorldRecord(
    epoch=7,
    attempt=1,
    instance=2,
    roster=encode_value(ROSTER.plain()),
    highest_version=4,
    last_digest=bytes(range(32)),
    state=START,
    intended=6,
    acted=5,
    trial=encode_trial("arm", ROSTER, ("token", 2, 5, ""), True),
    drains=True,
)
CHECKPOINT_BYTES = bytes.fromhex(
    "99 03 07 01 02 03 c3"
    "c4 0e 93 81 a4 6c6f7374 c2 a4 77616974 90"
    "c4 19 93 81 a4 6c6f7374 c3 a6 666f6c6c6f77 91 cb 3fe0000000000000"
    "c4 00"
)

MESSAGE = encode_message(Message(Header("obs", "arm", "mind", 6, time_s=0.5), ({"seen": True},)))

states = st.builds(encode_state, values, st.text(max_size=8), st.lists(values, max_size=2).map(tuple))
checkpoints = st.builds(Checkpoint, unsigned, unsigned, unsigned, unsigned, st.booleans(), states, states)
records = st.builds(
    lambda counts, *rest: WorldRecord(counts[2], *rest, intended=counts[1], acted=counts[0]),
    st.tuples(unsigned, unsigned, unsigned).map(sorted),
    unsigned,
    unsigned,
    st.just(WORLD.roster),
    st.integers(3, (1 << 64) - 1),
    st.binary(min_size=32, max_size=32),
    states,
)
under_ways = st.builds(
    encode_under_way,
    st.none() | st.tuples(st.integers(0, 1 << 40), values),
    st.lists(st.just(MESSAGE), max_size=2),
)
checkpoints = st.builds(Checkpoint._replace, checkpoints, under_way=st.just(b"") | under_ways)
patient = settings(max_examples=60)


@patient
@given(checkpoints)
def test_a_checkpoint_comes_back_as_it_was(checkpoint: Checkpoint) -> None:
    data = encode_checkpoint(checkpoint)
    assert decode_checkpoint(data) == checkpoint
    assert encode_checkpoint(decode_checkpoint(memoryview(data))) == data


@patient
@given(records)
def test_a_world_record_comes_back_as_it_was(record: WorldRecord) -> None:
    data = encode_world(record)
    assert decode_world(data) == record
    assert encode_world(decode_world(memoryview(data))) == data


def test_bytes_once_written_are_read_for_ever() -> None:
    assert encode_checkpoint(CHECKPOINT) == CHECKPOINT_BYTES
    assert decode_checkpoint(CHECKPOINT_BYTES) == CHECKPOINT


def test_any_msgpack_library_reads_them() -> None:
    assert msgpack.unpackb(encode_checkpoint(CHECKPOINT)) == [3, *CHECKPOINT]
    assert msgpack.unpackb(encode_world(WORLD)) == [3, *WORLD]


def test_what_is_inside_comes_back() -> None:
    assert decode_under_way(b"") == (None, (), (), {})
    forgotten = (("arm", "obs", 5, 2),)
    for gathered in ({}, {"world": ((6, "seen"), (7, "seen again"))}):
        under_way = decode_under_way(encode_under_way((7, {"lost": False}), [MESSAGE], forgotten, gathered))
        assert under_way.forgotten == forgotten
        assert under_way.sensed == (7, {"lost": False})
        assert under_way.gathered == gathered
        assert [encode_message(message) for message in under_way.said] == [MESSAGE]
    assert decode_roster(WORLD.roster) == ROSTER
    belief, policy, actions = decode_state(encode_state({"pose": np.eye(2)}, "follow", (1, "grip")))
    assert np.array_equal(belief["pose"], np.eye(2))
    assert (policy, actions) == ("follow", (1, "grip"))


WHOLE = "expected a whole number, got"
BOUNDED = "expected a whole number of 64 bits from 0, got"
COUNTS = "expected acted ≤ intended ≤ epoch, got"
CHECKPOINT_FAULTS: list[tuple[dict[str, Any], str, str]] = [
    *(({name: "7"}, name, f"{WHOLE} '7'") for name in ("epoch", "attempt", "instance", "roster")),
    *(({name: -1}, name, f"{BOUNDED} -1") for name in ("epoch", "attempt", "instance", "roster")),
    ({"epoch": True}, "epoch", f"{WHOLE} True"),
    ({"finished": 1}, "finished", "expected true or false, got 1"),
    ({"start": "text"}, "start", "expected bytes, got 'text'"),
    ({"now": None}, "now", "expected bytes, got None"),
    ({"under_way": ()}, "under_way", "expected bytes, got a tuple"),
]
WORLD_FAULTS: list[tuple[dict[str, Any], str, str]] = [
    *(({name: 0.5}, name, f"{WHOLE} 0.5") for name in ("epoch", "attempt", "instance", "highest_version", "acted")),
    *(({name: -1}, name, f"{BOUNDED} -1") for name in ("epoch", "attempt", "instance", "highest_version", "acted")),
    ({"roster": {}}, "roster", "expected bytes, got a dict"),
    ({"state": ()}, "state", "expected bytes, got a tuple"),
    ({"last_digest": b"short"}, "last_digest", "expected 32 bytes, got 5"),
    ({"intended": 8}, "intended, record.acted", f"{COUNTS} 5, 8, 7"),
    ({"acted": 7}, "intended, record.acted", f"{COUNTS} 7, 6, 7"),
]
CHECKPOINT_INSIDE: list[tuple[dict[str, Any], str, str]] = [
    ({"start": b""}, "start", "not one msgpack value"),
    ({"start": START + b"\0"}, "start", "not one msgpack value"),
    ({"now": encode_value((1, "wait"))}, "now", "expected an array of belief, policy and actions"),
    ({"now": encode_value({})}, "now", "expected an array of belief, policy and actions"),
    ({"now": encode_value((1, 2, ()))}, "now.policy", "expected a string, got 2"),
    ({"now": encode_value((1, "wait", "go"))}, "now.actions", "expected an array of elements, got 'go'"),
    ({"under_way": b"\xc1"}, "under_way", "not one msgpack value"),
    *(
        ({"under_way": encode_value(value)}, "under_way", "expected an array of what was sensed, of mess")
        for value in (
            None,
            (),
            ((), ()),
            ((), "text", ()),
            ((), (1,), ()),
            (1, (), ()),
            (("2", None), (), ()),
            (np.zeros(2), (), ()),
        )
    ),
]
WORLD_INSIDE: list[tuple[dict[str, Any], str, str]] = [
    ({"roster": b"\xc1"}, "roster", "not one msgpack value"),
    ({"roster": encode_value(None)}, "roster", "expected a map with the keys"),
    ({"roster": encode_value({**ROSTER.plain(), "version": -1})}, "roster.version", "a whole number from 0, got -1"),
    ({"highest_version": 2}, "highest_version", "expected at least the roster's version 3, got 2"),
    ({"state": encode_value((1, 2, ()))}, "state.policy", "expected a string, got 2"),
]


def by_hand(record: Checkpoint | WorldRecord) -> bytes:
    return encode_value((3, *record))


def check(error: SchemaError, where: str, what: str) -> None:
    assert error.where == where
    assert what in error.what
    assert len(str(error)) < 200


@pytest.mark.parametrize(("change", "where", "what"), CHECKPOINT_FAULTS + CHECKPOINT_INSIDE)
def test_a_checkpoint_that_is_none_is_refused_by_field(change: dict[str, Any], where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_checkpoint(by_hand(CHECKPOINT._replace(**change)))
    check(raised.value, f"checkpoint.{where}", what)


@pytest.mark.parametrize(("change", "where", "what"), WORLD_FAULTS + WORLD_INSIDE)
def test_a_world_record_that_is_none_is_refused_by_field(change: dict[str, Any], where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_world(by_hand(WORLD._replace(**change)))
    check(raised.value, f"record.{where}", what)


@pytest.mark.parametrize(
    ("change", "where", "what"), [*CHECKPOINT_FAULTS, ({"attempt": TOO_LARGE}, "attempt", f"{BOUNDED} {TOO_LARGE}")]
)
def test_no_checkpoint_is_written_that_cannot_be_read(change: dict[str, Any], where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        encode_checkpoint(CHECKPOINT._replace(**change))
    check(raised.value, f"checkpoint.{where}", what)


@pytest.mark.parametrize(
    ("change", "where", "what"), [*WORLD_FAULTS, ({"attempt": TOO_LARGE}, "attempt", f"{BOUNDED} {TOO_LARGE}")]
)
def test_no_world_record_is_written_that_cannot_be_read(change: dict[str, Any], where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        encode_world(WORLD._replace(**change))
    check(raised.value, f"record.{where}", what)


def test_a_record_too_large_is_refused() -> None:
    with pytest.raises(SchemaError, match=f"at most {MAX_MESSAGE_BYTES} are allowed"):
        encode_checkpoint(CHECKPOINT._replace(now=bytes(MAX_MESSAGE_BYTES)))


@pytest.mark.parametrize(
    ("data", "where", "what"),
    [
        (b"", "checkpoint", "not one msgpack value"),
        (encode_value(None), "checkpoint", "expected an array of 9 fields"),
        (encode_value(()), "checkpoint", "expected an array of 9 fields"),
        (encode_value((1, "of another version")), "checkpoint.format", "format 1; this version reads format 3"),
        (encode_value((True, *CHECKPOINT)), "checkpoint.format", "format True; this version reads format 3"),
        (encode_value((3, *CHECKPOINT, 0)), "checkpoint", "expected an array of 9 fields, got 10"),
        (encode_world(WORLD), "checkpoint", "expected an array of 9 fields, got 16"),
    ],
)
def test_other_bytes_are_no_checkpoint(data: bytes, where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_checkpoint(data)
    check(raised.value, where, what)


def test_a_checkpoint_is_no_world_record() -> None:
    with pytest.raises(SchemaError, match="record: expected an array of 16 fields, got 9"):
        decode_world(encode_checkpoint(CHECKPOINT))


def outcome(decode: Callable[[bytes], Any], data: bytes) -> Any:
    try:
        return decode(data)
    except SchemaError as error:
        return error


@patient
@given(randoms, st.sampled_from([encode_checkpoint(CHECKPOINT), encode_world(WORLD)]), st.integers(1, 4))
def test_changed_bytes_give_a_record_or_a_schema_error(random: Random, data: bytes, changes: int) -> None:
    changed = bytearray(data)
    for _ in range(changes):
        changed[random.randrange(len(changed))] = random.randrange(256)
    checkpoint, world = (outcome(decode, bytes(changed)) for decode in (decode_checkpoint, decode_world))
    assert len(str(checkpoint)) < 2000
    assert isinstance(checkpoint, SchemaError) or decode_checkpoint(encode_checkpoint(checkpoint)) == checkpoint
    assert isinstance(world, SchemaError) or decode_world(encode_world(world)) == world
