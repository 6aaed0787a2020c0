"""Recordings are read to where they were cut off, wherever that is; what is damaged is named."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.info import RecordingError, RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of
from hierax.runtime.recording.topics import MESSAGE, STEP, glance, topic_of
from hierax.runtime.recording.writing import McapFile
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, Header, Message, encode_message
from hierax.schemas.steps import encode_step
from hierax.schemas.values import encode_value

SEED = 20


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return record_file(folder / "run.mcap", path, "gain=0.25", seed=5)[0]


@pytest.fixture(scope="module")
def chunked(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, every few entries a chunk of its own."""
    path = tmp_path_factory.mktemp("chunked") / "run.mcap"
    file = McapFile(path, recording.info)
    for number, entry in enumerate(recording.entries()):
        file.add(entry)
        if number % 5 == 4:
            file.flush(at_once=True)
    assert recording.ending is not None
    file.close(recording.ending)
    return path


def test_it_says_what_it_is_of(recording: Recording) -> None:
    info = recording.info
    assert (info.hierarchy, info.mode, info.seed, info.staleness) == ("flawed", "run", 5, 0)
    assert tuple(info.settings) == ("gain=0.25",)
    assert info.deployment_text == DEPLOYMENT
    assert info.from_start
    assert info.machine["processors"] >= 1
    assert {"hierax", "numpy", "mcap"} <= info.versions.keys()
    assert recording.ending is not None
    assert (recording.ending.first, recording.ending.last, recording.ending.lost) == (1, 12, 0)
    assert not recording.loss


def test_all_that_was_said_can_be_asked_for(recording: Recording) -> None:
    assert sum(1 for _ in recording.messages()) == 12 * 6
    down = [message for _, message in recording.messages(first=3, last=4, node="high", kind=CONTEXT)]
    assert [(each.header.sender, each.header.receiver, each.header.epoch) for each in down] == [
        ("high", "low", 3),
        ("high", "low", 4),
    ]
    assert [step.epoch for step in recording.steps("low")] == list(range(1, 13))
    assert list(recording.rosters()) == [0]
    digests = recording.digests()
    assert list(digests) == list(range(1, 13))
    epochs = list(recording.epochs(2, 3))
    assert [epoch.epoch for epoch in epochs] == [2, 3]
    assert epochs[0].digest == digests[2]
    assert epochs[0].order == ("world", "low", "high")
    state = epochs[1].state_of("low")
    assert state is not None
    assert state.policy == "move"
    assert not any(epoch.lacking for epoch in recording.epochs())


def test_other_programs_see_channels_with_schemas(recording: Recording) -> None:
    from mcap.reader import make_reader

    with recording.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {channel.topic.partition(f"/{recording.info.run}/")[2] for channel in summary.channels.values()}
    edges = {f"{kind}/{a}/{b}" for a, b in (("low", "world"), ("high", "low")) for kind in ("task", "ctx")}
    assert edges | {"obs/world/low", "obs/low/high", "steps/low", "roster", "epochs"} <= topics
    assert {channel.message_encoding for channel in summary.channels.values()} == {"msgpack"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}


def test_cut_off_anywhere_all_whole_chunks_are_there(recording: Recording, chunked: Path, tmp_path: Path) -> None:
    data = chunked.read_bytes()
    whole = [entry.data for entry in recording.entries()]
    print("seed", SEED)
    drawn = random.Random(SEED)
    path = tmp_path / "cut.mcap"
    last = 0
    for at in sorted(drawn.randrange(len(data) // 8, len(data)) for _ in range(60)):
        path.write_bytes(data[:at])
        cut = Recording.open(path)
        assert cut.ending is None
        assert "it was cut off" in cut.loss
        there = [entry.data for entry in cut.entries()]
        assert there == whole[: len(there)]
        assert len(there) % 5 == 0 or len(there) == len(whole)
        assert len(there) >= last
        last = len(there)
        epochs = list(cut.epochs())
        assert [epoch.epoch for epoch in epochs] == list(range(1, len(epochs) + 1))
        complete = [epoch.epoch for epoch in epochs if not epoch.lacking]
        if complete:
            assert compare(
                cut.epochs(last=complete[-1]), Replay(cut, allowance_of(cut), last=complete[-1]).epochs()
            ).alike
    assert last == len(whole)


@pytest.mark.parametrize("name", ["high", "low", "world"])
def test_what_a_killed_process_did_not_tell_its_next_one_does(recording: Recording, name: str, tmp_path: Path) -> None:
    """Of its last epoch: the state at the beginning of the next one, and none of that one's time or inputs."""
    path = tmp_path / "killed.mcap"
    file = McapFile(path, recording.info)
    state = b""
    for entry in recording.entries():
        data = entry.data
        if entry.topic.what == STEP and entry.topic.names == (name,):
            step = entry.step()
            if step.epoch == 4:
                state = step.state
                continue
            data = encode_step(step._replace(start=state)) if step.epoch == 5 else data
        file.add(entry._replace(data=data))
    assert recording.ending is not None
    file.close(recording.ending)
    killed = Recording.open(path)
    whole, lacking = (next(each.epochs(first=4)) for each in (recording, killed))
    assert lacking.lacking == ()
    assert whole.nodes.keys() == lacking.nodes.keys()
    assert {trace.step.time_s for trace in lacking.nodes.values()} == {whole.time_s}
    comparison = compare(killed.epochs(), Replay(killed, allowance_of(killed), world=True).epochs())
    assert comparison.alike, comparison
    assert comparison.digests == comparison.epochs == 12


def test_damage_before_the_end_is_named(chunked: Path, tmp_path: Path) -> None:
    data = bytearray(chunked.read_bytes())
    at = data.rindex(b"zstd", 0, len(data) // 2) + 40
    data[at] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"damaged\.mcap: is damaged before byte \d+"):
        list(Recording.open(path).entries())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file"),
        (b"", "is no recording"),
        (b"hierarchy: servo\n", "is no recording"),
        (b"\x89MCAP0\r\n", "was cut off before it says what it is of"),
    ],
)
def test_what_is_no_recording_is_refused(content: bytes | None, said: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=f"x\\.mcap: {said}"):
        Recording.open(path)


def test_anybody_elses_mcap_file_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "somebody")
        writer.finish()
    with pytest.raises(RecordingError, match="profile 'ros2', not one that hierax wrote"):
        Recording.open(path)


def test_another_format_is_refused(recording: Recording) -> None:
    with pytest.raises(RecordingError, match="format 4; this version reads formats 1 to 3"):
        RunInfo.read({**recording.info.plain(), "format": 4})
    assert RunInfo.read({**recording.info.plain(), "format": 2, "exact": False}).format == 2
    later = RunInfo.read({**recording.info.plain(), "new": 1})
    assert later == recording.info


def test_a_file_that_cannot_be_written_is_named(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere/x\.mcap: cannot be written: No such file"):
        McapFile(tmp_path / "nowhere" / "x.mcap", recording.info)


def test_keys_are_told_apart() -> None:
    assert topic_of("hierax/d/r/obs/a/b") == (MESSAGE, "obs", ("a", "b"))
    assert topic_of("hierax/d/r/steps/a") == (STEP, "", ("a",))
    assert topic_of("hierax/d/r/interrupt/a/a") is None
    assert topic_of("hierax/d/r/obs/a") is None
    assert topic_of("hierax/d/r") is None


def test_a_glance_is_the_header() -> None:
    header = Header("ctx", "a", "b", 1 << 40, 3, 4, 5, 0.5, bytes(32), {"x": ("y",)})
    data = encode_message(Message(header, ({"k": 1},)))
    seen, payload_at = glance(data)
    assert seen[:9] == header[:9]
    assert data[payload_at:] == encode_value(({"k": 1},))
    with pytest.raises(SchemaError, match="does not begin like a message"):
        glance(b"\x93\x01")
