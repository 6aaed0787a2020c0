"""``hierax logs``: what the processes of a launch have said."""

import json
import logging
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, BinaryIO

from hierax.runtime.commands.options import Format, OutputFormat, option
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_folder import LOGS, about_run, is_alive, known_folders, meant
from hierax.runtime.host.streams import printable
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.watch.logs import AUDIT, LAUNCH, LAUNCH_FILE, OUTPUT, SUFFIX

Entry = dict[str, Any]

_AGO = re.compile(r"(\d+(?:\.\d+)?)\s*([smhd])")
_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400}
POLL_S = 0.2
HEAD_BYTES = 256  # a log's first lines, with their times, are no other log's


def find_folder(run: str | None) -> Path:
    """The folder of a launch; of several that may be meant the youngest, one that runs before those that have ended.
    Raises `HieraxError` if there is none; with the nearest name."""
    folders = known_folders()
    if not folders:
        raise HieraxError("no launch has left a log on this machine")
    found = folders
    if run is not None:
        found = meant(run, folders, _names)
    if not found:
        names = filter(None, (name for each in folders for name in _names(each)))
        raise HieraxError(f"--run: there is no log of a launch {run!r}{did_you_mean(str(run), names, 'there are')}")
    return next(filter(is_alive, found), found[0])


def _names(folder: Path) -> tuple[str, str]:
    """The identification of a launch, and its hierarchy's name; the latter may be empty."""
    return folder.name, str(about_run(folder).get("hierarchy", ""))


def read_since(text: str, now: datetime) -> datetime:
    """A time ``10m`` ago (s, m, h, d), or as ISO 8601, local without a zone; `HieraxError` if it is neither."""
    ago = _AGO.fullmatch(text.strip())
    try:
        if ago is not None:
            return now - timedelta(seconds=float(ago[1]) * _SECONDS[ago[2]])
        return datetime.fromisoformat(text.strip().replace("Z", "+00:00")).astimezone(timezone.utc)
    except (ValueError, OverflowError) as error:  # the latter: there was no such year
        what = f"--since: expected how long ago, such as 10m, or a time such as 2030-01-02T03:04, got {text!r:.80}"
        raise HieraxError(what) from error


def read_pattern(text: str) -> re.Pattern[str]:
    """Read a regular expression. Raises `HieraxError` if it is none."""
    try:
        return re.compile(text)
    except re.error as error:
        raise HieraxError(f"--grep: {text!r} is no regular expression: {error}") from error


@dataclass(frozen=True)
class LogFilter:
    """Which entries of a log are shown."""

    nodes: Sequence[str] = ()  # of these alone, or of the nodes of these processes; empty: of all
    level: str = "DEBUG"  # from this one on
    since: datetime | None = None  # not from before; None: from the beginning
    pattern: re.Pattern[str] | None = None  # found in message, logger's name or traceback; None: anything

    def __call__(self, entry: Entry) -> bool:
        """Whether an entry is."""
        if self.nodes and not {entry.get("node"), entry.get("process")}.intersection(self.nodes):
            return False
        if _number(entry.get("level")) < _number(self.level):
            return False
        if self.since is not None and _time(entry) < self.since:
            return False
        texts = (str(entry.get(field, "")) for field in ("message", "logger", "exception"))
        return self.pattern is None or any(map(self.pattern.search, texts))


@dataclass
class _Place:
    """How far a file was read."""

    at: int = 0  # from this byte on it is new
    head: bytes = b""  # how the file began: another one may be given its number when it is gone
    look: int = 0  # the last one in which it was there

    def is_in(self, size: int, head: bytes) -> bool:
        """Whether it is a place in a file of this size that begins so; files only grow."""
        return self.at <= size and head.startswith(self.head)


class Reader:
    """Reads the files of a launch's logs, again and again, each time what is new. `folder`: of the launch; `audit`:
    whether who changed what is read, in place of all else."""

    def __init__(self, folder: Path, audit: bool = False) -> None:
        self._audit = audit
        self._logs = folder / LOGS
        self._places: dict[int, _Place] = {}  # by the files' numbers (inodes)
        self._look = 0  # how often was read

    @property
    def names(self) -> list[str]:
        """Who has a log: nodes, and ``launch``."""
        files = {path.name.removesuffix(SUFFIX) for path in self._logs.glob(f"*{SUFFIX}")}
        return sorted(
            {LAUNCH if name == LAUNCH_FILE else name for name in files if not name.startswith((OUTPUT, AUDIT))}
        )

    def read(self) -> list[Entry]:
        """What was written since the last time, in order of time."""
        entries: list[Entry] = []
        self._look += 1
        for path in sorted(self._logs.glob(f"*{SUFFIX}*"), reverse=True):  # what was put aside before what was not
            if path.name.startswith(AUDIT) == self._audit:
                entries += self._read(path)
        # one that was put aside just now may have been found under neither name: it is there the next time
        self._places = {number: place for number, place in self._places.items() if place.look >= self._look - 1}
        return sorted(entries, key=_time)

    def _read(self, path: Path) -> Iterator[Entry]:
        # it may be put aside just now: then it is read under its other name the next time
        with suppress(FileNotFoundError), path.open("rb") as file:
            place = self._place_in(file)
            file.seek(place.at)
            for line in file:
                if not line.endswith(b"\n"):
                    return  # being written
                place.at += len(line)
                yield from _parsed(line)

    def _place_in(self, file: BinaryIO) -> _Place:
        """How far a file was read, also before it was put aside under another name."""
        status, head = os.fstat(file.fileno()), file.read(HEAD_BYTES)
        place = self._places.get(status.st_ino)
        if place is None or not place.is_in(status.st_size, head):
            place = self._places[status.st_ino] = _Place()
        place.head, place.look = head, self._look
        return place


def _parsed(line: bytes) -> Iterable[Entry]:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return []  # torn by the death of its process, or none of ours
    return [entry] if isinstance(entry, dict) and isinstance(entry.get("time"), str) else []


def _time(entry: Mapping[str, Any]) -> datetime:
    try:
        return datetime.fromisoformat(entry["time"].replace("Z", "+00:00")).astimezone(timezone.utc)
    except (ValueError, OverflowError):  # the latter: in UTC it is in no year
        return datetime.min.replace(tzinfo=timezone.utc)


def _number(level: Any) -> int:
    number = logging.getLevelName(level) if isinstance(level, str) else level
    return number if isinstance(number, int) else logging.INFO


def _local(when: datetime) -> datetime:
    """A time in the local zone; one that is in no year there as it is."""
    try:
        return when.astimezone()
    except OverflowError:
        return when


def line(entry: Entry) -> str:
    """An entry as text: local time, level, node and epoch, message; a traceback below."""
    clock = _local(_time(entry)).strftime("%H:%M:%S.%f")[:-3]
    node, process = entry.get("node", "?"), entry.get("process")
    where = f"{node if process in (None, node) else f'{process}/{node}'} epoch {entry.get('epoch', 0)}"
    text = f"{clock} {entry.get('level', '')} {where}: {entry.get('message', '')}"
    return printable(f"{text}\n{entry['exception']}" if entry.get("exception") else text)


class Level(str, Enum):
    """The levels of `logging`."""

    debug = "debug"
    info = "info"
    warning = "warning"
    error = "error"
    critical = "critical"


def logs(
    run: Annotated[
        str | None,
        option(
            "--run",
            help="Which launch, also one that has ended: its identification, or how that begins, or its hierarchy's "
            "name. By default, and of several, the youngest that runs, or else the last one.",
            autocompletion=lambda: [_names(folder) for folder in known_folders()],
        ),
    ] = None,
    node: Annotated[
        list[str] | None,
        option(
            "--node",
            metavar="NODE",
            help="Of this node alone, or of all that share the process of this name; `launch` is what happened to the "
            "processes. May be given several times.",
            autocompletion=lambda: sorted({name for folder in known_folders() for name in Reader(folder).names}),
        ),
    ] = None,
    level: Annotated[Level, option("--level")] = Level.debug,
    since: Annotated[str | None, option("--since")] = None,
    grep: Annotated[str | None, option("--grep")] = None,
    follow: Annotated[bool, option("--follow", "-f")] = False,
    audit: Annotated[bool, option("--audit")] = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Show the log of a launch: of all its processes, in order of time. JSON is one object a line."""
    log_filter = LogFilter(
        nodes=tuple(node or ()),
        level=level.value.upper(),
        since=None if since is None else read_since(since, datetime.now(timezone.utc)),
        pattern=None if grep is None else read_pattern(grep),
    )
    for entry in _entries(find_folder(run), log_filter, follow, audit):
        print(json.dumps(entry) if output_format is Format.json else line(entry), flush=follow)
    return 0


def _entries(folder: Path, log_filter: LogFilter, follow: bool, audit: bool) -> Iterator[Entry]:
    reader = Reader(folder, audit)
    unknown = [name for name in log_filter.nodes if name not in reader.names]
    if unknown and not follow:  # else it may come yet
        known = did_you_mean(unknown[0], reader.names, "there are those of")
        raise HieraxError(f"--node: there is no log of {unknown[0]!r} in run {folder.name}{known}")
    while True:
        goes_on = follow and is_alive(folder)
        yield from filter(log_filter, reader.read())
        if not goes_on:
            return
        time.sleep(POLL_S)
