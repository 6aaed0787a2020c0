"""The logs of a launch: one file of JSON lines for each node, and one for the supervisor.

Whatever a node's process says by Python's `logging` goes there, from level INFO; warnings and errors go to the console
as well. Every record has the fields ``run``, ``node``, ``epoch`` and ``attempt``, for formatters of one's own too.

    {"time": "2030-01-02T03:04:05.678901Z", "level": "WARNING", "run": "5163af85", "node": "arm",
     "epoch": 12, "attempt": 0, "logger": "hierax", "message": "…"}

``process`` is the name of a process that nodes share; ``exception`` holds a traceback; what is given as ``extra``
stands under its own names."""

import json
import logging
import logging.handlers
import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime, timezone
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from hierax.runtime.host.private_files import UnsafeFileError, open_result, private_folder, shown_alive
from hierax.runtime.host.run_folder import ABOUT, ALIVE, LOGS, begin_run, run_folder

OURS = "hierax"  # the logger whose records are counted: a node's own records are its user's matter
FIRST = 20  # so many records of a kind go through; then one for each pause

PAUSES_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""The pauses, each longer than the one before; the last one is kept. What is quiet for as long begins anew."""

MAX_KINDS = 512  # how many kinds of records are counted apart

MAX_BYTES = 4 << 20  # A file that has grown larger is put aside, in the place of the one put aside before
SUFFIX = ".jsonl"
LAUNCH = "launch"  # the supervisor's name among those of nodes
LAUNCH_FILE = f"_{LAUNCH}"  # its file's name, which no node's can have
AUDIT = "_audit"  # of the file of who changed what, or tried to

OUTPUT = "_output-"
"""How the name of a file begins in which a supervisor writes what libraries and programs of its nodes print."""

LEVEL_VARIABLE = "HIERAX_LOG"  # from which level on records go to the console; below INFO also to the files

QUIET = {"quiet": True}
"""As ``extra`` of a record: it is told on the console in another way, and goes to the file alone."""

When = Callable[[], tuple[int, int]]  # the epoch and attempt under way

NODE: ContextVar[str] = ContextVar("node", default="")
"""Whose work is being done, where nodes share a process: set in the node's thread, and what it awaits."""

_LOG = logging.getLogger(OURS)
_CONSOLE_FORMAT = "%(name)s: %(message)s"
_OURS = ("run", "node", "epoch", "attempt")
_NOT_TOLD = {"message", "asctime", "taskName", "quiet", "throttled", "shares"}
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {*_OURS, *_NOT_TOLD}


@dataclass
class _Kind:
    passed: int = 0
    pause: int = 0
    since_s: float = 0.0
    left_out: int = 0
    last: str = ""  # of those left out


class Throttle(logging.Filter):
    """Lets through some records of each kind (of one text before its arguments are put in), and counts the rest."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._kinds: dict[tuple[int, str], _Kind] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record goes through; one that does says how many like it did not."""
        if record.name != OURS or record.levelno >= logging.ERROR:
            return True
        found = getattr(record, "throttled", None)
        if found is None:  # else another handler has asked
            found = record.throttled = self._passes(record)
        return bool(found)

    def take_left_out(self) -> list[tuple[int, str, int]]:
        """Level, number and the last one's text of the records that were left out and are not told yet; then they
        are."""
        found = [(level, kind.last, kind.left_out) for (level, _), kind in self._kinds.items() if kind.left_out]
        self._kinds.clear()
        return found

    def _passes(self, record: logging.LogRecord) -> bool:
        key = (record.levelno, str(record.msg))
        if key not in self._kinds and len(self._kinds) >= MAX_KINDS:
            self._kinds.pop(next(iter(self._kinds)))
        kind = self._kinds.setdefault(key, _Kind(since_s=self._clock()))
        now = self._clock()
        quiet_s = now - kind.since_s
        if kind.passed < FIRST and not kind.left_out:
            kind.passed = 1 if quiet_s > PAUSES_S[0] else kind.passed + 1
            kind.since_s = now
            return True
        if quiet_s < PAUSES_S[kind.pause]:
            kind.left_out += 1
            kind.last = record.getMessage()
            return False
        if kind.left_out:
            record.msg = f"{record.getMessage()} (and {kind.left_out} more like it in the last {quiet_s:.0f} s)"
            record.args = ()
            kind.pause = min(kind.pause + 1, len(PAUSES_S) - 1)
            kind.left_out = 0
        else:
            kind.passed, kind.pause = 1, 0
        kind.since_s = now
        return True


_throttle = Throttle()  # the throttle of this process: on the console and in the file the same is left out


def log_console() -> None:
    """Have records go to standard error, but for those with ``quiet``, which are told there in another way."""
    given = os.environ.get(LEVEL_VARIABLE, "WARNING").upper()
    known = logging.getLevelName(given)
    level = known if isinstance(known, int) else logging.WARNING
    handler = logging.StreamHandler()
    handler.setLevel(level)
    handler.setFormatter(_ConsoleLine(_CONSOLE_FORMAT))
    handler.addFilter(_throttle.filter)
    handler.addFilter(lambda record: not getattr(record, "quiet", False))
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(level)
    if level is not known:
        _LOG.warning("%s: expected DEBUG, INFO, WARNING, ERROR or CRITICAL, got %r", LEVEL_VARIABLE, given)


def log_nodes(
    run: str, process: str, whens: Mapping[str, When], told: Mapping[str, logging.Handler] | None = None
) -> None:
    """Have the records of a process go to the files of its nodes, with what is under way there; or, where the files are
    on another host, to handlers by name.

    Where nodes share it, the process has a name, and a file for what is none of theirs: what their own threads say."""
    shares = len(whens) > 1
    make = logging.getLogRecordFactory()

    def make_with_fields(*arguments: Any, **options: Any) -> logging.LogRecord:
        record = make(*arguments, **options)
        node = NODE.get() if shares else process
        record.run, record.node = run, node if node in whens else process
        under_way = [whens[node]] if node in whens else whens.values()
        record.epoch, record.attempt = max(when() for when in under_way)
        if shares:
            record.shares = process
        return record

    logging.setLogRecordFactory(make_with_fields)
    folder = run_folder(run)
    known = os.path.exists(folder / ABOUT)  # Path's raises where one may not enter
    if not told and not known:  # for who keeps processes of a run of another machine here
        with suppress(OSError, UnsafeFileError):  # it is told when the file cannot be opened
            begin_run(run, {"hierarchy": "", "deployment": "", "pid": os.getppid()})
    for name in dict.fromkeys((*whens, process)):
        handler = told.get(name) if told else open_log(folder / LOGS, name)
        if handler is not None:
            _log_to(handler, name if shares else "")


def _log_to(handler: logging.Handler, node: str) -> None:
    """Have the records of one node go to a handler; of no name: all."""
    root = logging.getLogger()
    if node:
        handler.addFilter(lambda record: getattr(record, "node", "") == node)
    handler.addFilter(_throttle.filter)
    root.addHandler(handler)
    root.setLevel(min(root.level or logging.WARNING, logging.INFO))


def report_left_out() -> None:
    """Say, at the end, how many records were left out of which none like it has told since."""
    for level, text, count in _throttle.take_left_out():
        _LOG.log(level, "%d more like this were left out: %s", count, text, extra={"throttled": True})


def open_log(folder: Path, name: str) -> logging.Handler | None:
    """A handler that appends to the file of a name; None, with a warning, where it cannot be written."""
    path = folder / f"{name}{SUFFIX}"
    try:
        with private_folder(folder, make=True):
            handler = _File(path, maxBytes=MAX_BYTES, backupCount=1, encoding="utf-8", errors="backslashreplace")
    except (OSError, UnsafeFileError) as error:
        _LOG.warning("%s: the log cannot be written: %s", path, getattr(error, "strerror", None) or error)
        return None
    handler.setFormatter(JsonLine())
    return handler


class ForwardedLog:
    """A node's file, for the lines that its process makes on another host. `run`, `node`: as `log_nodes` has them."""

    def __init__(self, run: str, node: str) -> None:
        folder = run_folder(run) / LOGS
        self._handler = open_log(folder, node) if folder.is_dir() else None
        if self._handler is not None:
            self._handler.setFormatter(logging.Formatter("%(message)s"))

    def write(self, line: str) -> None:
        if self._handler is not None:
            self._handler.handle(logging.makeLogRecord({"msg": line}))

    def close(self) -> None:
        if self._handler is not None:
            self._handler.close()


class _ConsoleLine(logging.Formatter):
    """A record on the console: our own say themselves which node they are about, those of a node's modules don't."""

    def format(self, record: logging.LogRecord) -> str:
        text, node = super().format(record), getattr(record, "node", "")
        return text if not node or record.name.partition(".")[0] == "hierax" else f"{node}: {text}"


class JsonLine(logging.Formatter):
    """A record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        when = datetime.fromtimestamp(record.created, timezone.utc)
        fields: dict[str, Any] = {
            "time": when.isoformat(timespec="microseconds").replace("+00:00", "Z"),
            "level": record.levelname,
            **{name: getattr(record, name) for name in _OURS if hasattr(record, name)},
            "logger": record.name,
            "message": _message(record),
        }
        if hasattr(record, "shares"):
            fields["process"] = record.shares
        if record.exc_info and record.exc_info[0] is not None:
            fields["exception"] = self.formatException(record.exc_info)
        more = {name: value for name, value in vars(record).items() if name not in _STANDARD}
        try:
            return json.dumps({**more, **fields}, ensure_ascii=False, default=str)
        except (TypeError, ValueError):  # keys that are tuples, or what holds itself
            more = {str(name): repr(value) for name, value in more.items()}
            return json.dumps({**more, **fields}, ensure_ascii=False)


def _message(record: logging.LogRecord) -> str:
    try:
        return record.getMessage()
    except (TypeError, ValueError):  # its arguments do not fit its text; `logging` itself tells on the console
        return f"{record.msg} {record.args!r}"


class _File(logging.handlers.RotatingFileHandler):
    """Gives up where the disk does: a node goes on without its log."""

    _told = False

    def _open(self) -> TextIOWrapper:
        file = open_result(self.baseFilename, append=True, private=True)
        return os.fdopen(file, "a", encoding="utf-8", errors=self.errors)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the name in `logging`
        if not self._told:
            self._told = True
            print(f"hierax: {self.baseFilename}: cannot be written: {sys.exc_info()[1]}", file=sys.stderr)


@dataclass(eq=False)
class LaunchLog:
    """The supervisor's file of what happens to a run's processes, in which `epoch`; without a handler there is none."""

    handler: logging.Handler | None
    run: str
    epoch: Callable[[], int]
    alive: int | None = None  # descriptor by which the launch is shown alive, closed with the log

    def write(self, message: str, node: str = LAUNCH, logger: str = "hierax.launch", **more: Any) -> None:
        """Write a line; `more` are fields of its own."""
        if self.handler is None:
            return
        fields = {"name": logger, "levelno": logging.INFO, "levelname": "INFO", "msg": message}
        where = {"run": self.run, "node": node, "epoch": self.epoch(), "attempt": 0}
        self.handler.handle(logging.makeLogRecord({**more, **fields, **where}))

    def close(self, message: str = "") -> None:
        """Write a last line, if there is one to be written."""
        if message:
            self.write(message)
        if self.handler is not None:
            self.handler.close()
        if self.alive is not None:
            os.close(self.alive)
            self.alive = None


def log_of_run(run: str, name: str, epoch: Callable[[], int]) -> LaunchLog:
    """A further file of a launch's; nothing is written where its folder is not there."""
    folder = run_folder(run) / LOGS
    is_there = os.path.isdir(folder)  # Path's raises where one may not enter
    return LaunchLog(open_log(folder, name) if is_there else None, run, epoch)


def begin_log(
    run: str, hierarchy: str, deployment: Path, tell: Callable[[str], None], epoch: Callable[[], int]
) -> LaunchLog:
    """Make the folder of a launch, and its log; it goes on without where that cannot be, which `tell` tells people."""
    about = {"hierarchy": hierarchy, "deployment": str(deployment.resolve()), "pid": os.getpid()}
    alive = None
    try:
        alive = shown_alive(run_folder(run) / ALIVE)  # before anybody finds it, and looks whether it is
        folder = begin_run(run, about)
    except (OSError, UnsafeFileError) as error:
        tell(f"{run_folder(run)}: there will be no logs: {getattr(error, 'strerror', None) or error}")
        return LaunchLog(None, run, epoch, alive)
    log = LaunchLog(open_log(folder / LOGS, LAUNCH_FILE), run, epoch, alive)
    log.write(f"{hierarchy} is launched from {about['deployment']}")
    return log
