"""What commands about recordings have in common."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hierax.runtime.commands.errors import FAILED, OK, CommandError, notify

if TYPE_CHECKING:
    from hierax.runtime.commands.options import RunOptions
    from hierax.runtime.recording.diff import Comparison
    from hierax.runtime.recording.info import Ending
    from hierax.runtime.recording.reading import Recording
    from hierax.runtime.recording.selection import Selection
    from hierax.runtime.recording.writing import Target

SHOWN = 10  # how many gaps or violations are listed
SHOWN_CHARS = 400


def claimed_file(path: Path | None, overwrite: bool) -> AbstractContextManager[Target | None]:
    """Have the file of a recording, where one is wanted, before anything starts. Raises as `writing.claimed` does."""
    if path is None:
        return nullcontext()
    from hierax.runtime.recording.writing import claimed, require_mcap

    require_mcap()
    return claimed(path, overwrite)


def selection_of(options: RunOptions, is_recorded: bool = True) -> Selection:
    """What is recorded, by the options. Raises `HieraxError` if one is wrong, or nothing is recorded at all."""
    from hierax.runtime.recording.selection import Selection, check_pattern, read_duration, read_size

    size, duration = options.max_size, options.max_duration
    given = {"--exclude": options.exclude, "--max-size": size, "--max-duration": duration}
    alone = next((name for name, value in given.items() if value and not is_recorded), None)
    if alone is not None:
        raise CommandError(f"{alone}: only with --record, of which it leaves something out")
    max_bytes = None if size is None else read_size(size)
    max_duration_s = None if duration is None else read_duration(duration)
    return Selection(tuple(map(check_pattern, options.exclude or ())), max_bytes, max_duration_s)


def recording_of(path: Path) -> Recording:
    """Open a recording, and say what is known to lack in it."""
    from hierax.runtime.recording.reading import Recording

    recording = Recording.open(path)
    if recording.loss:
        notify(f"{path}: {recording.loss}")
    return recording


def report_ending(file: Path, ending: Ending) -> int:
    """Say what a recording lacks. Returns the exit code: 1 where it lacks something."""
    for pattern, count in ending.left_out.items():
        if not count:
            notify(f"--exclude {pattern}: nothing came on such a key")
    if ending.cut:
        notify(f"{file}: it ends with epoch {ending.last} ({ending.cut})")
    for gap in ending.cut_short[:SHOWN]:
        notify(f"cut short by its sender's death: {gap}")
    if not ending.lost:
        return OK
    for gap in ending.gaps[:SHOWN]:
        notify(f"not recorded: {gap}")
    print(f"error: {file}: {ending.lost} things that were said in the run are not in it", file=sys.stderr, flush=True)
    return FAILED


def report_outcome(file: Path | None, ending: Ending | None, violations: Sequence[Any]) -> int:
    """Say what is wrong with a recording, if there is to be one, and a check; the exit code."""
    code = OK if file is None or ending is None else report_ending(file, ending)
    return max(code, report_violations(violations))


def report_violations(violations: Sequence[Any]) -> int:
    """Say where the formal order is broken. Returns the exit code: 1 where it is."""
    if not violations:
        return OK
    for violation in violations[:SHOWN]:
        notify(str(violation))
    several = f"{len(violations)} times" if len(violations) > 1 else "once"
    print(f"error: the formal order is broken {several}", file=sys.stderr, flush=True)
    return FAILED


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """A comparison as plain JSON."""
    from hierax.runtime.execution.report import plain

    difference = comparison.difference
    return {
        **{name: getattr(comparison, name) for name in ("alike", "epochs", "equal", "digests")},
        "not_told": comparison.unknown,
        "rosters": [plain(each._asdict()) for each in comparison.rosters],
        "difference": None if difference is None else plain(difference._asdict()),
    }


def print_comparison(comparison: Comparison, a: str, b: str) -> None:
    """A comparison as text. `a`, `b`: what the two sides are called."""
    for roster in comparison.rosters:
        print(f"rosters differ from epoch {roster.epoch}: {roster.path}")
        _print_sides(a, roster.a, b, roster.b)
    difference = comparison.difference
    untold = f"; {comparison.unknown} results are not told on one side" if comparison.unknown else ""
    if difference is None:
        what = f"{comparison.epochs} epochs, {comparison.digests} digests: all results are alike"
        print(f"{what}{untold}")
        return
    print(f"first difference: epoch {difference.epoch}, {difference.subject}, {difference.operator}: {difference.path}")
    _print_sides(a, difference.a, b, difference.b)
    print(f"{comparison.equal} epochs before it are alike{untold}")


def _print_sides(a: str, left: Any, b: str, right: Any) -> None:
    width = max(len(a), len(b))
    for name, value in ((a, left), (b, right)):
        text = value.hex() if isinstance(value, bytes) else repr(value)
        print(f"  {name:<{width}}  {text if len(text) <= SHOWN_CHARS else text[:SHOWN_CHARS] + '…'}")
