"""What a recorder has no room for, or cannot read, is named and not lost in silence."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.recording.reading import Entry, Recording
from hierax.runtime.recording.recorder import Recorder
from hierax.runtime.recording.topics import MESSAGE, STEP, Selection
from hierax.runtime.transport.bus_tap import BEGINNING_BYTES
from hierax.runtime.transport.port import Sample
from hierax.schemas.limits import MAX_NAME_CHARS
from hierax.schemas.messages import HELLO, OBSERVATIONS, Header, Message, encode_message
from hierax.schemas.steps import encode_step
from hierax.schemas.values import encode_value

FAR = 10**12
KEY = "hierax/flawed/r"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return record_file(folder / "run.mcap", path)[0]


def heard(entry: Entry) -> Sample:
    return Sample(entry.time_ns, entry.key, entry.data)


def test_what_there_is_no_room_for_is_named(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for entry in recording.entries():
        what, kind, names = entry.topic
        is_picture = what == MESSAGE and kind == "obs" and names == ("world", "low") and entry.epoch == 4
        is_step = what == STEP and names == ("high",) and entry.epoch == 6
        if is_picture or is_step:
            recorder.drop(entry.key, entry.data[:BEGINNING_BYTES])
        else:
            recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert [str(gap) for gap in ending.gaps] == [
        "epoch 4: obs message world -> low: the recorder could not keep up",
        "epoch 6: step of high: the recorder could not keep up",
    ]
    assert ending.lost == 2


def test_what_is_left_out_is_named_by_those_who_said_and_heard_it(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for entry in recording.entries():
        if not (entry.topic.what == MESSAGE and entry.topic.kind == "task" and entry.epoch == 9):
            recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert ending.lost == 2
    assert {str(gap) for gap in ending.gaps} == {
        "epoch 9: task message high -> low of attempt 0",
        "epoch 9: task message low -> world of attempt 0",
    }


def test_a_run_of_which_nothing_was_heard_is_known(recording: Recording) -> None:
    ending = Recorder(recording.info, None).finish(12)
    assert (ending.last, ending.lost) == (0, 12)
    assert [str(gap) for gap in ending.gaps] == ["epoch 12: all epochs up to this one"]
    assert Recorder(recording.info, None).finish(0).lost == 0, "it had none"
    joined = replace(recording.info, from_start=False)
    assert Recorder(joined, None).finish(12).lost == 0, "it went at once"


def test_a_run_that_went_on_without_its_recorder_is_known(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for entry in recording.entries():
        if entry.epoch <= 10:
            recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert ending.last == 10
    assert ending.lost >= 6
    assert "epoch 11: steps of high from here on" in {str(gap) for gap in ending.gaps}


def test_bytes_of_another_kind_are_named(recording: Recording, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(recording.info, None)
    for key, data in (("obs/a/b", b"\x01"), ("steps/a", b"\x90"), ("epochs", b"\x05"), ("roster", b"\x80")):
        recorder.take(Sample(0, f"hierax/flawed/r/{key}", data))
    assert recorder.finish().lost == 4
    assert caplog.text.count("not recorded, as it is not of this kind") == 4


def test_so_many_epochs_are_recorded_and_no_more(recording: Recording) -> None:
    recorder = Recorder(replace(recording.info, from_start=False), None, epochs=3)
    for entry in recording.entries():
        recorder.take(heard(entry))
        if recorder.ledger.ended:
            break
    assert recorder.ledger.complete or recorder.ledger.ended
    ending = recorder.finish()
    assert ending.last - ending.first == 2


def test_what_comes_before_the_first_whole_epoch_takes_no_room(recording: Recording, tmp_path: Path) -> None:
    """A node may be told late that somebody records; until then the others fill no file."""
    late, most = 7, 72_000
    info = replace(recording.info, from_start=False)
    recorder = Recorder(info, tmp_path / "part.mcap", selection=Selection(max_bytes=most))
    for entry in recording.entries():
        if entry.topic.what != STEP or entry.topic.names != ("high",) or entry.epoch >= late:
            recorder.take(heard(entry))
    ending = recorder.finish()
    assert (ending.first, ending.lost) == (late + 1, 0)
    assert recorder.cut
    assert late < ending.last < 12
    part = Recording.open(tmp_path / "part.mcap")
    assert part.path.stat().st_size <= most
    assert min(entry.epoch for entry in part.entries(MESSAGE)) == late
    assert [epoch.lacking for epoch in part.epochs(ending.first)] == [()] * (ending.last - late)


def forgeries(recording: Recording) -> list[Sample]:
    """What a node `high` may put on its own keys, and says that it is of others."""
    first = {each.key.partition(recording.info.run)[2]: each for each in recording.entries() if each.epoch == 3}
    world, root = first["/steps/world"].step(), f"hierax/flawed/{recording.info.run}"
    header, _ = first["/obs/world/low"].message()
    said = [
        ("obs/high/nobody", encode_message(Message(header, ("another one",)))),
        ("ctx/high/low", encode_message(Message(header._replace(epoch=0), ()))),
        ("task/high/low", encode_message(Message(header._replace(sender="high", receiver="low"), ()))),
        ("steps/high", encode_step(world._replace(epoch=FAR, number=FAR))),
    ]
    return [Sample(0, f"{root}/{key}", data) for key, data in said]


def test_nobody_speaks_as_another_one(recording: Recording, tmp_path: Path) -> None:
    recorder = Recorder(recording.info, tmp_path / "forged.mcap", check=True)
    for entry in recording.entries():
        recorder.take(heard(entry))
        if entry.topic.what == STEP and entry.topic.names == ("world",) and entry.epoch == 5:
            for forged in forgeries(recording):
                recorder.take(forged)
    ending = recorder.finish(12)
    assert (ending.last, ending.lost) == (12, 4)
    assert [gap.what.partition(recording.info.run)[2] for gap in ending.gaps] == [
        "/obs/high/nobody: message: expected what its key names, got 'obs/world/low'",
        "/ctx/high/low: message: expected what its key names, got 'obs/world/low'",
        "/task/high/low: message: expected what its key names, got 'obs/high/low'",
        "/steps/high: step: expected what its key names, got 'world'",
    ]
    assert recorder.checker is not None
    assert recorder.checker.close() == []
    written = Recording.open(tmp_path / "forged.mcap")
    assert [each[:4] for each in written.entries()] == [each[:4] for each in recording.entries()]


def test_nor_does_what_there_is_no_room_for(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for forged in forgeries(recording):
        recorder.drop(forged.key, forged.data[:BEGINNING_BYTES])
    for entry in recording.entries():
        recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert (ending.last, ending.lost) == (12, 4)
    for forged, gap in zip(forgeries(recording), ending.gaps, strict=True):
        assert gap.what == f"{forged.key}: the recorder could not keep up"


def test_a_greeting_is_not_recorded_whoever_it_is_of(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for key in ("obs/low/high", "ctx/low/world"):
        recorder.take(Sample(0, f"{KEY}/{key}", encode_message(Message(Header(HELLO, "low", "high", 0), ({},)))))
    assert recorder.finish().lost == 0


def test_what_has_the_longest_header_is_named_by_its_beginning(recording: Recording) -> None:
    lower, upper = "l" * MAX_NAME_CHARS, "u" * MAX_NAME_CHARS
    trace = {"traceparent": "00-" + "a" * 52, "tracestate": "b" * 512}
    data = encode_message(Message(Header(OBSERVATIONS, lower, upper, 7, digest=bytes(32), extensions=trace), ("x",)))
    recorder = Recorder(recording.info, None)
    recorder.drop(f"{KEY}/obs/{lower}/{upper}", data[:BEGINNING_BYTES])
    (gap,) = recorder.finish().gaps
    assert str(gap) == f"epoch 7: obs message {lower} -> {upper}: the recorder could not keep up"


JUNK = {
    "nothing": b"",
    "no array": b"\x01",
    "cut off": b"\x90",
    "an extension": b"\x95\xc7\x04\xff",
    "a map with a key that cannot be one": b"\x95\x81\x91\x01\x01",
    "lists in lists": b"\x95" + b"\x91" * 2000,
    "an array that claims to be huge": b"\x95\xdd\x7f\xff\xff\xff",
    "no names": encode_value((1, ("world",), {}, 0.0, -1, "x")),
    "numbers below 0": encode_value((1, "a", "s", -1, 2)),
}


@pytest.mark.parametrize("junk", JUNK.values(), ids=JUNK.keys())
def test_junk_that_there_is_no_room_for_is_named_by_its_key(recording: Recording, junk: bytes) -> None:
    recorder, keys = Recorder(recording.info, None), ("obs/a/b", "steps/a", "epochs")
    for key in keys:
        recorder.drop(f"{KEY}/{key}", junk)
    named = [f"{KEY}/{key}: the recorder could not keep up" for key in keys]
    assert [gap.what for gap in recorder.finish().gaps] == named


def test_no_junk_ends_a_recorder(recording: Recording) -> None:
    random_ = random.Random(f"{SEED}")
    said = [entry for entry in recording.entries() if entry.epoch in (0, 1, 2)]
    for number in range(400):
        recorder = Recorder(recording.info, None, check=True)
        entry = random_.choice(said)
        data = bytearray(entry.data)
        for _ in range(random_.randint(1, 4)):
            data[random_.randrange(len(data))] = random_.randrange(256)
        spoilt = bytes(data[: random_.choice((len(data), random_.randrange(len(data))))])
        print(f"seed {SEED}, number {number}: {entry.key}: {spoilt.hex()}")
        recorder.take(Sample(0, entry.key, spoilt))
        recorder.drop(entry.key, spoilt[:BEGINNING_BYTES])


SEED = 5


@pytest.mark.parametrize(
    "value", [(float("inf"), b""), (float("nan"), b""), (3.0, b""), (True, b""), (-1, b""), (3, "x"), (3, b"", 0), "ab"]
)
def test_an_epoch_that_is_none_is_named(recording: Recording, value: object) -> None:
    recorder = Recorder(recording.info, None)
    recorder.take(Sample(0, f"{KEY}/epochs", encode_value(value)))
    (gap,) = recorder.finish().gaps
    assert gap.what.startswith(f"{KEY}/epochs: epoch: expected an epoch's number and digest, got ")
