"""What a run writes into its output folder, and who writes what.

    roster.msgpack        the roster's content, encoded; the supervisor or `run`
    digests.msgpack       stream of [epoch, digest]; the world's process
    states/NAME.msgpack   stream of [epoch, attempt, state, digest]; each node's process
    states/.NAME.whole    up to where that is known to be whole, once it is long; likewise
    summary.json          the report; the command

and whatever the deployment's probes write."""

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import BinaryIO, Protocol

import msgpack

from hierax.runtime.core.errors import FAILURES, HieraxError, ProbeError
from hierax.runtime.core.probe import Probe
from hierax.runtime.execution.report import Report
from hierax.runtime.host.private_files import HeldError, close_held, errors_named, open_held, open_result, write_result
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_probe
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.roster import ProbeSpec, Roster
from hierax.schemas.values import encode_value

ROSTER = "roster.msgpack"
DIGESTS = "digests.msgpack"
STATES = "states"
SUMMARY = "summary.json"
MARKED_BYTES = 64 << 20  # after so many it is marked up to where a log is whole: more is not read where one goes on
END_BYTES = 32  # of what stands before a mark, beside which it is a mark of another file: a digest, mostly
MARK = ".whole"
REPLACED = ".replaced"  # the folder of what another run has left there, until the one in its place has done an epoch


def write_summary(output: Path, report: Report) -> None:
    """Write the report. Raises `OutputError` if it cannot be written."""
    start = {} if report.start_s is None else {"start_s": report.start_s}
    summary = json.dumps({**report.plain(), **start}, indent=2, allow_nan=False)
    with errors_named(output / SUMMARY, kind=OutputError):
        write_result(output / SUMMARY, summary.encode() + b"\n")


class EpochLog(Protocol):
    """Takes the entries of a run's epochs."""

    def write(self, *fields: int | bytes) -> None: ...

    def flush(self) -> None: ...

    def close(self) -> None: ...


class Log:
    """A stream of msgpack arrays that outlives its process. Raises `HieraxError` if it cannot be written."""

    def __init__(self, path: Path, append: bool = False) -> None:
        self._path = path  # of the file
        with errors_named(self._path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = os.fdopen(open_result(path, append), "ab" if append else "wb")
            if not append:
                self._file.truncate(0)
                _mark_of(path).unlink(missing_ok=True)
        self._unmarked = 0
        # Go on behind what is there, but for an entry that was cut off; this is looked at when something is written, as
        # until then another process may still be writing. What is whole now is read now, before an epoch waits for it.
        self._behind = append
        with errors_named(self._path):
            self._whole = _whole_bytes(path, _marked_bytes(path)) if append else 0

    def write(self, *fields: int | bytes) -> None:
        try:  # entering a context would take longer, and this runs in every epoch
            if self._behind:
                self._behind = False
                os.truncate(self._path, _whole_bytes(self._path, self._whole))
            self._file.write(msgpack.packb(fields))
            self._unmarked += sum(len(field) for field in fields if isinstance(field, bytes))
            if self._unmarked > MARKED_BYTES:
                self._mark()
        except OSError:
            with errors_named(self._path):
                raise

    def _mark(self) -> None:
        self._unmarked = 0
        self._file.flush()
        with self._path.open("rb") as file:
            whole = file.seek(0, os.SEEK_END)
            file.seek(max(whole - END_BYTES, 0))
            write_result(_mark_of(self._path), msgpack.packb((whole, file.read(END_BYTES))))

    def flush(self) -> None:
        """Give what is buffered to the system: then it outlives the process."""
        with errors_named(self._path):
            self._file.flush()

    def close(self) -> None:
        with errors_named(self._path):
            self._file.close()


def _mark_of(path: Path) -> Path:
    return path.with_name(f".{path.stem}{MARK}")


def _marked_bytes(path: Path) -> int:
    """Up to where a log is known to hold whole arrays; 0 where nobody has marked that, in this file."""
    try:
        whole, end = msgpack.unpackb(_mark_of(path).read_bytes())
        with path.open("rb") as file:
            file.seek(whole - len(end))
            return int(whole) if end and file.read(len(end)) == end else 0
    except (OSError, ValueError, TypeError, msgpack.UnpackException):
        return 0


def _whole_bytes(path: Path, known: int = 0) -> int:
    """Up to where a stream of msgpack arrays holds whole ones; up to `known`, if it is that long, it does."""
    with path.open("rb") as file:
        whole = start = known if known <= os.fstat(file.fileno()).st_size else 0
        file.seek(start)
        unpacker = msgpack.Unpacker(file, max_buffer_size=MAX_MESSAGE_BYTES)
        try:
            while True:
                unpacker.skip()
                whole = start + unpacker.tell()
        except (msgpack.OutOfData, ValueError):
            return whole


class OutputError(HieraxError):
    """An output folder cannot be used; says why."""


@contextmanager
def claimed_output(output: Path, overwrite: bool = False, goes_on: bool = False) -> Iterator[None]:
    """Have an output folder for this run alone; made where it lacks.

    `overwrite` removes what another run has left there: what this module writes, and nothing else; `goes_on` resumes
    it. Where this run ends before it has committed an epoch, what was there is there again, and nothing else. Raises
    `OutputError` if it cannot be written, another process writes there, or there is a run in it."""
    roster, is_made = output / ROSTER, not output.exists()
    try:
        output.mkdir(parents=True, exist_ok=True)
        file = open_held(roster, partial(_refusal, output))
    except OSError as error:
        raise OutputError(f"--output {output}: it cannot be made or written: {error.strerror or error}") from error
    try:
        if not goes_on and (output / REPLACED).is_dir():  # of a run that was killed
            _settle(output)
        there = _of_a_run(output)
        if there and not (overwrite or goes_on):
            what = f"there is a run in it already ({there[0].relative_to(output)})"
            raise OutputError(f"--output {output}: {what}; --overwrite replaces it, or name another folder")
        if there and not goes_on:
            _set_aside(output, there)
        try:
            yield
        finally:
            if not goes_on or (output / REPLACED).is_dir():
                _settle(output)
    finally:
        close_held(roster, file)
        if is_made:
            with suppress(OSError):  # there is something in it
                output.rmdir()


def _refusal(output: Path, holder: str) -> HeldError:
    return HeldError(f"--output {output}: {holder} is writing there; name another folder")


def _set_aside(output: Path, there: Sequence[Path]) -> None:
    aside = output / REPLACED
    with errors_named(aside, kind=OutputError):
        (aside / STATES).mkdir(parents=True)
        for path in there:
            if path.name == ROSTER:  # which is held, and stays
                write_result(aside / ROSTER, path.read_bytes())
            else:
                path.rename(aside / path.relative_to(output))


def _settle(output: Path) -> None:
    """Of the run that is over and the one before: keep the former if it has come to anything, or else the latter."""
    aside, roster = output / REPLACED, output / ROSTER
    if not _has_epoch(output):
        with errors_named(output, kind=OutputError):
            for path in (output / DIGESTS, *(output / STATES).glob("*.msgpack"), *(output / STATES).glob(f".*{MARK}")):
                path.unlink(missing_ok=True)
            write_result(roster, (aside / ROSTER).read_bytes() if (aside / ROSTER).exists() else b"")
            for path in _of_a_run(aside):
                if path.name != ROSTER:
                    (output / STATES).mkdir(exist_ok=True)
                    path.rename(output / path.relative_to(aside))
        with suppress(OSError):  # it is needed, or was never made
            (output / STATES).rmdir()
    shutil.rmtree(aside, ignore_errors=True)


def _has_epoch(output: Path) -> bool:
    """Whether a run has committed one: a killed process may not have written the digests, but states are written at
    once, and the second epoch begins when the first one is committed."""
    told = [output / name for name in (DIGESTS, SUMMARY)]
    is_told = any(path.is_file() and path.stat().st_size for path in told)
    return is_told or any(map(_has_second, (output / STATES).glob("*.msgpack")))


def _has_second(states: Path) -> bool:
    with states.open("rb") as file, suppress(ValueError, TypeError, LookupError, msgpack.UnpackException):
        return any(entry[0] > 1 for entry in msgpack.Unpacker(file, max_buffer_size=MAX_MESSAGE_BYTES))
    return False  # it is torn before that


def _of_a_run(output: Path) -> list[Path]:
    named = [output / name for name in (ROSTER, DIGESTS, SUMMARY)]
    found = [path for path in named if path.is_file() and path.stat().st_size]
    return found + sorted((output / STATES).glob("*.msgpack"))


def write_roster(output: Path, roster: Roster) -> None:
    """Write the content that the digests cover. Raises `HieraxError` if it cannot be written."""
    with errors_named(output / ROSTER, kind=OutputError):
        output.mkdir(parents=True, exist_ok=True)
        write_result(output / ROSTER, encode_value(roster.content()))


def state_log(output: Path | None, name: str, append: bool = False) -> Log | None:
    """Where a node's states go; behind what is there, for a process that comes in the place of another."""
    return None if output is None else Log(output / STATES / f"{name}.msgpack", append)


def digest_log(output: Path | None, append: bool = False) -> Log | None:
    """Where a run's digests go; behind what is there, where the world's process is not the first one."""
    return None if output is None else Log(output / DIGESTS, append)


def open_probes(
    specs: Sequence[ProbeSpec], name: str, allowance: Allowance, output: Path | None, again: bool = False
) -> tuple[Probe, ...]:
    """The probes of a node, open; `again`: another process of the node has had them open before in this run."""
    own = [(i, spec) for i, spec in enumerate(specs) if spec.node == name]
    probes = tuple(build_probe(spec.reference, f"probes[{i}]", allowance) for i, spec in own)
    for probe, (_, spec) in zip(probes, own, strict=True):
        probe.overwrite = spec.overwrite
        try:
            (probe.open_again if again else probe.open)(output)
        except FAILURES as error:
            raise ProbeError(name, probe, "open", error) from error
    return probes
