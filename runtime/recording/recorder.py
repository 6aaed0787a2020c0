"""A recorder: takes in what is said in a run, writes it down, keeps account of it, and has it checked."""

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgpack

from hierax.runtime.recording.check import Checker
from hierax.runtime.recording.info import Ending, Gap, RunInfo
from hierax.runtime.recording.ledger import Ledger
from hierax.runtime.recording.topics import (
    EPOCH,
    EVERYTHING,
    MESSAGE,
    ROSTER,
    STEP,
    TOKEN,
    Entry,
    Selection,
    Topic,
    glance,
    topic_of,
)
from hierax.runtime.recording.writing import McapFile, Target
from hierax.runtime.transport.port import Sample
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import Keys
from hierax.schemas.messages import DRAIN, GREETING, HELLO, Header
from hierax.schemas.roster import Roster
from hierax.schemas.steps import decode_step
from hierax.schemas.values import decode_value, encode_value

if TYPE_CHECKING:
    from hierax.runtime.execution.runner import NodeRunner

ENDING_BYTES = 64 << 10  # what a file says at its end of how it ended, where no more than some hundred things lack

HELD_BYTES = 64 << 20
"""How much may wait, in a recording that joins a run, for its first whole epoch; with more, all is written."""

_log = logging.getLogger("hierax")


class Recorder:
    """Takes in what comes on the keys of a run, for a file, if one is given, and, if it is to `check`, for a checker,
    which sees all of it. A file that `claimed` gave stays as it was until an epoch is committed. `epochs` is as the
    `Ledger` has it, and the selection says what is written. Raises `RecordingError` if the file cannot be written."""

    def __init__(
        self,
        info: RunInfo,
        file: Path | Target | None,
        check: bool = False,
        selection: Selection = EVERYTHING,
        epochs: int | None = None,
    ) -> None:
        self.info = replace(info, left_out=tuple(selection.exclude))
        self.checker = Checker(info.how_stale, info.from_start) if check else None
        self.ledger = Ledger(info.from_start, epochs)
        self.cut = ""  # by which option of the selection nothing more is written
        self._selection = selection
        self._left_out = dict.fromkeys(selection.exclude, 0)
        self._pattern = cache(selection.leaves_out)
        self._begun_ns = self._newest = self._largest = self._bytes = self._mark = 0
        self._file = None if file is None else McapFile(file, self.info)
        self._barrier = info.how_stale.barrier
        self._is_rated = False  # whether nodes have rates
        self._versions: set[int] = set()
        self._held: list[Entry] | None = None if info.from_start else []
        self._messages = self._held_bytes = 0

    def take(self, heard: Sample) -> None:
        """Take in what came on a key. Raises `RecordingError` if the file cannot be written."""
        topic = topic_of(heard.key)
        if topic is None:
            return
        try:
            epoch, data = self._account(topic, heard)
        except (ValueError, TypeError) as error:  # a SchemaError is one
            _log.warning("not recorded, as it is not of this kind: %s: %s", heard.key, error)
            self.ledger.add(Gap(0, f"{heard.key}: {error}"))
            return
        if epoch < 0 or not self.ledger.wants(epoch):
            return
        pattern = self._pattern(heard.key)
        if pattern:
            self._left_out[pattern] += 1
            return
        entry = Entry(heard.key, topic, heard.time_ns, epoch, data)
        if self._held is None:
            self._write(entry)
            return
        self._held.append(entry)
        self._held_bytes += len(data)
        if self.ledger.first or self._held_bytes > HELD_BYTES:
            self._write_held()

    def drop(self, key: str, data: bytes) -> None:
        """Something was heard on a key, but there was no room for it; `data` is its beginning."""
        topic = topic_of(key)
        if topic is None:
            return
        epoch, what = self.ledger.last, key
        with suppress(SchemaError):  # it may be junk, or its header longer than what is left of it: its key is known
            epoch, what = self._dropped(topic, data) or (epoch, what)
        self.ledger.add(Gap(epoch, f"{what}: the recorder could not keep up"))

    def flush(self) -> None:
        """Write what has waited for long enough. Raises `RecordingError` if the file cannot be written."""
        if self._file is not None:
            self._file.flush()

    def finish(self, last: int | None = None) -> Ending:
        """Nothing more comes after the run's last epoch, if that is known; `RecordingError` if it cannot be written."""
        ledger = self.ledger
        self._write_held()
        if self.cut and ledger.cut is not None:
            ledger.last = min(ledger.last, ledger.cut)  # what was held told of later epochs, too
            last = None if last is None else min(last, ledger.cut)
        ledger.cut = None
        if ledger.from_start and last and not ledger.last:  # nor was anybody heard who could say what lacks
            ledger.add(Gap(last, "all epochs up to this one", last))
        gaps, lost = ledger.close(last if self._barrier else None)
        first = ledger.first if ledger.last >= ledger.first else 0
        cut_short = tuple(ledger.cut_short)
        ending = Ending(first, ledger.last, self._messages, gaps, lost, cut_short, self.cut, self._left_out)
        if self._file is not None:
            if ending.last:
                self._file.begin()
            self._file.close(ending)
        return ending

    def _write(self, entry: Entry) -> None:
        self._messages += 1
        if self._file is not None:
            self._file.add(entry)
            if self.ledger.last:
                self._file.begin()
            self._keep_bounds(self._file, entry)

    def _write_held(self) -> None:
        """Until every node has told of an epoch, it is not known with which one the recording begins. The epoch before
        that one is written, too: in it the nodes told the states with which this one begins."""
        held, self._held = self._held, None
        first = self.ledger.first - 1 if self._barrier and not self._is_rated else 0
        # no epoch is read before its roster
        for entry in sorted(held or (), key=lambda entry: entry.topic.what != ROSTER):
            if (not entry.epoch or entry.epoch >= first) and self.ledger.wants(entry.epoch):
                self._write(entry)

    def _keep_bounds(self, file: McapFile, entry: Entry) -> None:
        """The last epoch that is recorded is the one under way when another one may be too much."""
        longest_s, most = self._selection.max_duration_s, self._selection.max_bytes
        if self.cut or (longest_s is None and most is None):
            return
        self._begun_ns = self._begun_ns or entry.time_ns
        self._bytes = file.bulk
        if entry.epoch > self._newest:
            self._largest = max(self._largest, self._bytes - self._mark)
            self._newest, self._mark = entry.epoch, self._bytes
            rest = 2 * self._largest + ENDING_BYTES  # the epoch that begins, and another one
            if most is not None and file.size + rest > most:
                file.flush(at_once=True)  # only then it is known what the compressed chunk takes
                if file.size + rest > most:
                    self.cut = f"--max-size {most} bytes"
        if longest_s is not None and entry.time_ns - self._begun_ns > longest_s * 1e9:
            self.cut = f"--max-duration {longest_s:g} s"
        if self.cut:
            self.ledger.end(max(self._newest, self.ledger.first))  # one whole epoch there is in any case

    def _dropped(self, topic: Topic, data: bytes) -> tuple[int, str] | None:
        """Epoch and name of a message or step, by its beginning, from now on accounted for; None: it is neither. Raises
        `SchemaError` if it does not begin like one of its key."""
        if topic.what == MESSAGE:
            seen, _ = glance(data)
            _check_key(topic, *seen.line)
            self.ledger.message(seen.line, *seen.when)
            return seen.epoch, f"{seen.kind} message {seen.sender} -> {seen.receiver}"
        if topic.what == STEP:
            name, stream, number, epoch = _glance_step(data)
            _check_key(topic, "", name)
            self.ledger.number(name, stream, number, epoch)
            return epoch, f"step of {name}"
        return None

    def _account(self, topic: Topic, heard: Sample) -> tuple[int, bytes]:
        """Epoch and bytes of what is recorded; an epoch below 0: it is not."""
        data = heard.data
        if topic.what == MESSAGE:
            return self._on_message(topic, data), data
        if topic.what == STEP:
            step = decode_step(data)
            _check_key(topic, "", step.name)
            self.ledger.step(step)
            if self.checker is not None and (self.cut or self.ledger.wants(step.epoch)):
                self.checker.step(step)
            return step.epoch, data
        if topic.what == ROSTER:
            return self._on_roster(Roster.read(decode_value(data, "roster"))), data
        if topic.what == EPOCH:
            epoch, _ = Entry(heard.key, topic, heard.time_ns, 0, data).commit()
            return epoch, data
        if topic.what == TOKEN:
            return 0, encode_value((*topic.names, heard.is_up))
        return 0, data

    def _on_message(self, topic: Topic, data: bytes) -> int:
        seen, _ = glance(data)
        if seen.kind == HELLO:
            return -1
        _check_key(topic, *seen.line)
        if seen.epoch == GREETING:
            return 0
        wanted = self.ledger.wants(seen.epoch)
        if wanted:
            self.ledger.message(seen.line, *seen.when, drains=DRAIN in seen.extensions)
        if self.checker is not None and (wanted or self.cut):
            self.checker.message(data)
        return seen.epoch

    def _on_roster(self, roster: Roster) -> int:
        """Versions are told again and again; each is recorded once."""
        if roster.version in self._versions:
            return -1
        self._versions.add(roster.version)
        self._is_rated = roster.rates is not None
        self.ledger.expect(roster)
        if self.checker is not None:
            self.checker.roster(roster)
        return 0


def _check_key(topic: Topic, kind: str, *names: str) -> None:
    """Who may put on a key is told by its names (`hierax.schemas.access`), so what comes there can be of nobody else.
    Raises `SchemaError` if it says that it is; of a step the kind is empty."""
    if (topic.kind, *topic.names) != (kind, *names):
        named = "/".join((kind, *names) if kind else names)
        raise SchemaError(f"expected what its key names, got {shown(named)}", topic.what)


def _glance_step(data: bytes) -> tuple[str, str, int, int]:
    """Name, stream, number and epoch of a step, by its beginning. Raises `SchemaError` if it begins otherwise."""
    unpacker = msgpack.Unpacker(max_buffer_size=len(data))  # lengths that lie end here, before they take memory
    unpacker.feed(data)
    try:
        unpacker.read_array_header()
        _, name, stream, number, epoch = (unpacker.unpack() for _ in range(5))
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise SchemaError(f"does not begin like a step: {data[:8].hex()}", STEP) from error
    if tuple(map(type, (name, stream, number, epoch))) != (str, str, int, int) or min(number, epoch) < 0:
        raise SchemaError("expected a name, a stream's token, a number and an epoch after the format", STEP)
    return name, stream, number, epoch


class InProcess:
    """Hands what is said between the nodes of one process to a recorder."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.checker = recorder.checker
        self.ending: Ending | None = None  # it goes on
        self._keys = Keys(recorder.info.hierarchy, recorder.info.run)
        self._last = 0

    def message(self, header: Header, data: bytes) -> None:
        self._take(self._keys.edge(header.kind, header.sender, header.receiver), data)

    def committed(self, epoch: int, digest: bytes) -> None:
        self._last = epoch
        self._take(self._keys.epochs, encode_value((epoch, digest)))
        self._recorder.flush()

    def watch(self, name: str, runner: "NodeRunner", roster: Callable[[], Roster] | None) -> None:
        """Have a node tell its steps; `roster` is given for the world alone, and gives the roster in force."""
        from hierax.runtime.recording.witness import Witness  # a launch's recorder does without engines

        tell_step, tell_roster = partial(self._take, self._keys.steps(name)), partial(self._take, self._keys.roster)
        runner.watch(Witness(name, lambda: runner.engine, tell_step, tell_roster, roster))

    def finish(self) -> None:
        """The run is over. Raises `RecordingError` if the file cannot be written."""
        self.ending = self._recorder.finish(self._last)

    def _take(self, key: str, data: bytes) -> None:
        self._recorder.take(Sample(time.time_ns(), key, data))
