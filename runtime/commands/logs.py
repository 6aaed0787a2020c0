"""``hierax logs``: what the processes of a launch have said."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from datetime import datetime, timezone
from enum import Enum
from pathlib import Path
from typing import Annotated

from hierax.runtime.commands.options import Format, OutputFormat, option
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_folder import about_run, is_alive, known_folders
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.tools.logs import Entry, LogFilter, Reader, find_folder, line, read_pattern, read_since

POLL_S = 0.2


class Level(str, Enum):
    """The levels of `logging`."""

    debug = "debug"
    info = "info"
    warning = "warning"
    error = "error"
    critical = "critical"


def _runs_logged() -> list[tuple[str, str]]:
    """Give, for completion, the launches that have left logs."""
    return [(folder.name, str(about_run(folder).get("hierarchy", ""))) for folder in known_folders()]


def _names_logged() -> list[str]:
    """Give, for completion, those that have a log."""
    return sorted({name for folder in known_folders() for name in Reader(folder).names})


def logs(
    run: Annotated[
        str | None,
        option(
            "--run",
            help="Which launch, also one that has ended: its identification, or how that begins, or its hierarchy's "
            "name. By default, and of several, the youngest that runs, or else the last one.",
            autocompletion=_runs_logged,
        ),
    ] = None,
    node: Annotated[
        list[str] | None,
        option(
            "--node",
            metavar="NODE",
            help="Of this node alone; `launch` is what happened to the processes. May be given several times.",
            autocompletion=_names_logged,
        ),
    ] = None,
    level: Annotated[Level, option("--level")] = Level.debug,
    since: Annotated[str | None, option("--since")] = None,
    grep: Annotated[str | None, option("--grep")] = None,
    follow: Annotated[bool, option("--follow", "-f")] = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Show the log of a launch: of all its processes, in order of time. JSON is one object a line."""
    log_filter = LogFilter(
        nodes=tuple(node or ()),
        level=level.value.upper(),
        since=None if since is None else read_since(since, datetime.now(timezone.utc)),
        pattern=None if grep is None else read_pattern(grep),
    )
    for entry in _entries(find_folder(run), log_filter, follow):
        print(json.dumps(entry) if output_format is Format.json else line(entry), flush=follow)
    return 0


def _entries(folder: Path, log_filter: LogFilter, follow: bool) -> Iterator[Entry]:
    reader = Reader(folder)
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
