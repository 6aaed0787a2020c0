"""Recordings are read to where they were cut off, wherever that is; what is damaged is named."""

from __future__ import annotations

import random
import struct
import tracemalloc
import zlib
from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.commands.main import main
from hierax.runtime.host.private_files import HeldError
from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.info import RecordingError, RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of
from hierax.runtime.recording.topics import MESSAGE, STEP, Entry, Topic, glance, topic_of
from hierax.runtime.recording.trace import Assembly
from hierax.runtime.recording.writing import ENDING, INFO, MAGIC, McapFile, claimed
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


PREFIX = struct.Struct("<BQ")
"""What is in front of a record: its kind, and how many bytes follow."""

MESSAGE_RECORD, CHUNK_RECORD, UNKNOWN_RECORD = 0x05, 0x06, 0x80


def before_chunks(data: bytes) -> bytes:
    """What is in a recording before its first chunk."""
    at = len(MAGIC)
    while data[at] != CHUNK_RECORD:
        at += PREFIX.size + PREFIX.unpack_from(data, at)[1]
    return data[:at]


def chunk(content: bytes, length: int | None = None) -> bytes:
    """A chunk that is not compressed, and says that its data have a length."""
    head = struct.pack("<QQQIIQ", 0, 0, len(content), 0, 0, len(content) if length is None else length)
    return PREFIX.pack(CHUNK_RECORD, len(head) + len(content)) + head + content


@pytest.mark.parametrize(
    "damaged",
    [
        chunk(bytes(64), length=1 << 63),
        chunk(bytes(64), length=1 << 40),
        chunk(bytes(64), length=65),
        chunk(PREFIX.pack(UNKNOWN_RECORD, (1 << 64) - 1) + bytes(64)),
        chunk(PREFIX.pack(UNKNOWN_RECORD, 1 << 40) + bytes(64)),
        chunk(PREFIX.pack(MESSAGE_RECORD, 1 << 40) + bytes(64)),
        chunk(PREFIX.pack(MESSAGE_RECORD, 3) + bytes(64)),
        chunk(bytes(5)),
        PREFIX.pack(MESSAGE_RECORD, 3) + bytes(64),
        PREFIX.pack(UNKNOWN_RECORD, (1 << 64) - 1) + bytes(64),
    ],
    ids=lambda damaged: damaged[:80].hex().rstrip("0")[-40:],
)
def test_lengths_that_are_none_are_damage(
    recording: Recording, damaged: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "damaged.mcap"
    path.write_bytes(before_chunks(recording.path.read_bytes()) + damaged + chunk(bytes(PREFIX.size)))
    assert main(["check", str(path)]) == 1
    (said,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("error: "))
    assert said.startswith(f"error: {path}: is damaged before byte ")
    assert len(said) < 300


def test_of_a_chunk_one_message_at_a_time_is_in_memory(recording: Recording, tmp_path: Path) -> None:
    empty = PREFIX.pack(MESSAGE_RECORD, 22) + bytes(22)
    content = empty * 100_000
    path = tmp_path / "many.mcap"
    path.write_bytes(before_chunks(recording.path.read_bytes()) + chunk(content))
    many = Recording.open(path)
    tracemalloc.start()
    try:
        assert list(many.entries()) == []  # of no channel
        assert tracemalloc.get_traced_memory()[1] < 3 * len(content)
    finally:
        tracemalloc.stop()


def test_an_index_takes_no_memory_however_many_chunks_there_are(recording: Recording, tmp_path: Path) -> None:
    chunks, channels = 3000, 20
    file = McapFile(tmp_path / "long.mcap", recording.info)
    keys = [f"hierax/d/r/obs/world/{number}" for number in range(channels)]
    topic = Topic(MESSAGE, "obs", ("world", "arm"))

    def write(epochs: range) -> None:
        for epoch in epochs:
            for key in keys:
                file.add(Entry(key, topic, epoch, epoch, b"x"))
            file.flush(at_once=True)

    write(range(1, 101))
    tracemalloc.start()
    try:
        write(range(101, chunks + 1))
        bound = file.size
        assert tracemalloc.get_traced_memory()[0] < 1_500_000  # it was 1.6 kB a chunk
        assert recording.ending is not None
        file.close(recording.ending)
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()
    size = (tmp_path / "long.mcap").stat().st_size
    assert abs(size - bound) < 2000  # but for how it ended
    assert [each.name for each in tmp_path.iterdir()] == ["long.mcap"]
    assert Recording.open(tmp_path / "long.mcap").ending == recording.ending


def test_other_programs_find_messages_by_the_index(chunked: Path) -> None:
    from mcap.reader import make_reader
    from mcap.records import Footer, MessageIndex
    from mcap.stream_reader import StreamReader

    data = chunked.read_bytes()
    with chunked.open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
        file.seek(0)
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 10
        assert [each.name for each in reader.iter_metadata()] == [INFO, ENDING]
        assert [each.name for each in reader.iter_attachments()] == ["deployment.yaml"]
        topics = {channel.id: channel.topic for channel in summary.channels.values()}
        written = list(Recording.open(chunked).entries())
        assert summary.statistics.message_count == len(written)
        assert len(list(reader.iter_messages())) == len(written)
        for number, topic in topics.items():
            wanted = [entry.data for entry in written if entry.key == topic]
            assert [message.data for _, _, message in reader.iter_messages([topic])] == wanted
            assert summary.statistics.channel_message_counts[number] == len(wanted)
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == CHUNK_RECORD
        assert index.message_index_offsets
        for number, at in index.message_index_offsets.items():
            assert data[at + PREFIX.size : at + PREFIX.size + 2] == struct.pack("<H", number)
        assert sum(offset < index.chunk_start_offset for offset in index.message_index_offsets.values()) == 0
    counts = [len(record.records) for record in records if isinstance(record, MessageIndex)]
    assert sum(counts) == len(written)
    footer = records[-1]
    assert isinstance(footer, Footer)
    assert zlib.crc32(data[footer.summary_start : -len(MAGIC) - 4]) == footer.summary_crc


@pytest.mark.parametrize("options", [{"use_summary_offsets": False}, {"use_statistics": False, "use_chunking": False}])
def test_how_it_ended_is_found_in_what_others_have_written_anew(
    recording: Recording, options: dict[str, bool], tmp_path: Path
) -> None:
    from mcap.records import Metadata
    from mcap.stream_reader import StreamReader
    from mcap.writer import Writer

    path = tmp_path / "anew.mcap"
    with recording.path.open("rb") as file, path.open("wb") as other:
        writer = Writer(other, **options)  # type: ignore[arg-type]
        writer.start("hierax", "somebody")
        for record in StreamReader(file).records:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
        channels: dict[str, int] = {}
        for entry in recording.entries():
            if entry.key not in channels:
                channels[entry.key] = writer.register_channel(entry.key, "msgpack", 0)
            writer.add_message(channels[entry.key], entry.time_ns, entry.data, entry.time_ns, entry.epoch)
        writer.finish()
    anew = Recording.open(path)
    assert anew.ending == recording.ending
    assert list(anew.entries()) == list(recording.entries())


def without_steps_of(recording: Recording, name: str) -> list[Entry]:
    return [each for each in recording.entries() if each.topic.what != STEP or each.topic.names != (name,)]


def test_without_steps_of_the_world_memory_has_a_bound(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is too much is dropped, the oldest first; where the world tells later, the rest is there."""
    entries = without_steps_of(recording, "world")
    monkeypatch.setattr("hierax.runtime.recording.trace.PENDING_BYTES", sum(len(each.data) for each in entries) // 2)
    assembly = Assembly(recording.info.how_stale)
    for entry in entries:
        assembly.take(entry)
        assert list(assembly.ripe()) == []
    for entry in recording.entries(STEP):
        if entry.topic.names == ("world",):
            assembly.take(entry)
    epochs = list(assembly.ripe(at_end=True))
    assert [each.epoch for each in epochs] == list(range(1, 13))
    lacking = [bool(each.lacking) for each in epochs]
    assert 3 <= sum(lacking) <= 9
    assert lacking == sorted(lacking, reverse=True)


def test_so_it_has_where_the_world_tells_nothing_any_more(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hierax.runtime.recording.trace.PENDING_EPOCHS", 4)
    assembly = Assembly(recording.info.how_stale)
    found = []
    late = [each for each in recording.entries(STEP) if each.topic.names == ("world",) and each.epoch > 2]
    for entry in [each for each in recording.entries() if each not in late] + late:
        assembly.take(entry)
        found += assembly.ripe()
    found += assembly.ripe(at_end=True)
    assert [each.epoch for each in found] == list(range(1, 13))
    assert [each.epoch for each in found if not each.lacking][:2] == [1, 2]
    assert not found[-1].lacking
    assert any(each.lacking for each in found)


def test_where_the_worlds_steps_were_left_out_it_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "part.mcap"
    for pattern in ("steps/world", "steps/*"):
        options = ["--epochs", "3", "--record", str(path), "--exclude", pattern, "--overwrite"]
        assert main(["run", "servo", *options]) == 0
        capsys.readouterr()
        for command in (["replay", str(path)], ["diff", str(path), "servo"], ["diff", str(path), str(path)]):
            assert main(command) == 1
            assert capsys.readouterr().err.splitlines()[-1] == (
                f"error: {path}: no step of the world is recorded, so it is not known which epochs were committed: "
                f"steps/world was left out (--exclude {pattern})"
            )


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


def test_who_is_refused_a_file_leaves_it_to_who_is_about_to_write_it(recording: Recording, tmp_path: Path) -> None:
    """Nothing is in it until an epoch is committed."""
    path = tmp_path / "run.mcap"
    assert recording.ending is not None
    with claimed(path) as target:
        file = McapFile(target, recording.info)
        for _ in range(2):
            with pytest.raises(HeldError, match="is writing it; name another file"), claimed(path):
                pass
        file.begin()
        file.close(recording.ending)
    assert Recording.open(path).info == recording.info


def test_a_claimed_file_that_somebody_has_put_another_one_in_the_place_of_is_left(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with claimed(path):
        path.unlink()
        path.write_bytes(MAGIC)
    assert path.read_bytes() == MAGIC


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
