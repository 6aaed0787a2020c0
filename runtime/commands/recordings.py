"""``hierax record``, ``check`` and ``diff``, and what all commands about recordings have in common."""

import signal
import sys
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hierax.runtime.commands.errors import FAILED, OK, CommandError, notify
from hierax.runtime.commands.options import (
    Format,
    OutputFormat,
    RecordingFile,
    RunOptions,
    WorldMode,
    argument,
    offers,
    option,
)
from hierax.runtime.commands.show import in_force_text, print_json
from hierax.runtime.commands.which_launch import client_at, launch_meant
from hierax.runtime.host.private_files import check_encodable
from hierax.runtime.host.streams import printable
from hierax.schemas.limits import LARGEST

if TYPE_CHECKING:
    from hierax.runtime.recording.diff import Comparison, EpochView
    from hierax.runtime.recording.info import Ending
    from hierax.runtime.recording.reading import Recording
    from hierax.runtime.recording.replay import Replay
    from hierax.runtime.recording.topics import Selection
    from hierax.runtime.recording.writing import Target

SHOWN = 10  # how many gaps or violations are listed
SHOWN_CHARS = 400


def claimed_file(path: Path | None, overwrite: bool) -> "AbstractContextManager[Target | None]":
    """Have the file of a recording, where one is wanted, before anything starts. Raises as `writing.claimed` does."""
    if path is None:
        return nullcontext()
    from hierax.runtime.recording.writing import claimed

    check_encodable(path)
    return claimed(path, overwrite)


def selection_of(options: RunOptions, is_recorded: bool = True) -> "Selection":
    """What is recorded, by the options. Raises `HieraxError` if one is wrong, or nothing is recorded at all."""
    from hierax.runtime.recording.topics import Selection, check_pattern, read_duration, read_size

    size, duration = options.max_size, options.max_duration
    given = {"--exclude": options.exclude, "--max-size": size, "--max-duration": duration}
    alone = next((name for name, value in given.items() if value and not is_recorded), None)
    if alone is not None:
        raise CommandError(f"{alone}: only with --record, of which it leaves something out")
    max_bytes = None if size is None else read_size(size)
    max_duration_s = None if duration is None else read_duration(duration)
    return Selection(tuple(map(check_pattern, options.exclude or ())), max_bytes, max_duration_s)


def recording_of(path: Path) -> "Recording":
    """Open a recording, and say what is known to lack in it."""
    from hierax.runtime.recording.reading import Recording

    recording = Recording.open(path)
    if recording.loss:
        notify(f"{path}: {recording.loss}")
    return recording


def report_ending(file: Path, ending: "Ending") -> int:
    """Say what a recording lacks. Returns the exit code: 1 where it lacks something."""
    for pattern, count in ending.left_out.items():
        if not count:
            notify(f"--exclude {pattern}: nothing came on such a key")
    if not ending.last:
        notify(f"{file}: no epoch was {'heard' if ending.lost else 'committed'}, so it is not written")
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


def report_outcome(file: Path | None, ending: "Ending | None", violations: Sequence[Any]) -> int:
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


def comparison_json(comparison: "Comparison") -> dict[str, Any]:
    from hierax.runtime.execution.report import plain

    difference = comparison.difference
    return {
        **{name: getattr(comparison, name) for name in ("alike", "epochs", "equal", "digests")},
        "not_told": comparison.unknown,
        "rosters": [plain(each._asdict()) for each in comparison.rosters],
        "difference": None if difference is None else plain(difference._asdict()),
    }


def print_comparison(comparison: "Comparison", a: str, b: str) -> None:
    """A comparison as text. `a`, `b`: what the two sides are called."""
    for roster in comparison.rosters:
        print(printable(f"rosters differ from epoch {roster.epoch}: {roster.path}", kept=""))
        _print_sides(a, roster.a, b, roster.b)
    difference = comparison.difference
    untold = f"; {comparison.unknown} results are not told on one side" if comparison.unknown else ""
    if difference is None:
        what = f"{comparison.epochs} epochs, {comparison.digests} digests: all results are alike"
        print(f"{what}{untold}")
        return
    where = f"epoch {difference.epoch}, {difference.subject}, {difference.operator}: {difference.path}"
    print(printable(f"first difference: {where}", kept=""))
    _print_sides(a, difference.a, b, difference.b)
    print(f"{comparison.equal} epochs before it are alike{untold}")


def _print_sides(a: str, left: Any, b: str, right: Any) -> None:
    width = max(len(a), len(b))
    for name, value in ((a, left), (b, right)):
        text = value.hex() if isinstance(value, bytes) else repr(value)
        print(printable(f"  {name:<{width}}  {text if len(text) <= SHOWN_CHARS else text[:SHOWN_CHARS] + '…'}"))


def check(file: RecordingFile, output_format: OutputFormat = Format.text) -> int:
    """Check a recording against the formal order: sense up before predict down, each edge once, inputs of the epoch."""
    from hierax.runtime.recording.check import check_recording

    checker = check_recording(recording_of(file))
    violations = checker.close()
    if not checker.checked and not violations:
        what = f"{checker.epochs} epochs are committed in it, and no step of a node can be checked"
        raise CommandError(f"{file}: there is nothing to check: {what}")
    if output_format is Format.json:
        found = [each._asdict() for each in violations]
        counts = {"epochs": checker.epochs, "steps": checker.checked}
        turns = {name: each._asdict() for name, each in sorted(checker.turns.items())}
        print_json({"file": str(file), **counts, **({"nodes": turns} if turns else {}), "violations": found})
    elif not violations:
        print(f"{file}: {checker.epochs} epochs, {checker.checked} steps of nodes: the formal order is kept")
        for name, done in sorted(checker.turns.items()):
            counting = f", with {in_force_text(done.in_force)}" if done.in_force else ""
            print(f"  {name}: {done.steps} epochs, the last one {done.last}{counting}")
    return report_violations(violations)


@offers("run", "connect", "key", "exclude", "max_size", "max_duration", "overwrite", "output_format")
def record(
    options: RunOptions,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The MCAP file.", dir_okay=False)],
    hierarchy: Annotated[
        str | None, argument("LAUNCH", "Its hierarchy's name, or its run, as `hierax ps` lists them.")
    ] = None,
    epochs: Annotated[int | None, option("--epochs", min=1, max=LARGEST, help="Stop after N epochs.")] = None,
) -> int:
    """Record a launch that runs, until it is over, or Ctrl-C. Exit code 1 if something said is not in the file."""
    from hierax.runtime.recording.info import RunInfo
    from hierax.runtime.recording.live_recording import LiveRecording
    from hierax.runtime.recording.recorder import Recorder
    from hierax.schemas.access import Access

    if hierarchy is not None and options.run is not None:
        raise CommandError("give the launch or --run, not both")
    selection = selection_of(options)
    with claimed_file(output, options.overwrite) as target:
        launch = launch_meant(options.run if hierarchy is None else hierarchy, options.connect, options.key)
        with client_at(launch) as client:
            told = client.ask({"ask": "record"})
        info, access = RunInfo.read(told), Access.read(told.get("access"))
        recorder = Recorder(info, target, selection=selection, epochs=epochs)
        recording = LiveRecording(recorder, launch.endpoint, access, watches=True, secret=launch.secret)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: recording.stop())
        notify(f"recording {info.hierarchy}, run {info.run}; Ctrl-C ends it")
        ending = recording.record()
    if options.output_format is Format.json:
        print_json({"file": str(output), "hierarchy": info.hierarchy, "run": info.run, **ending.plain()})
    else:
        count = max(ending.last - ending.first + 1, 0) if ending.first else 0
        print(f"{output}: {count} epochs, {ending.first} to {ending.last}, {ending.messages} messages")
    return report_ending(output, ending)


@offers("first", "last", "tolerance", "overrides", "trust", "output_format")
def diff(
    file: RecordingFile,
    other: Annotated[str, argument("OTHER", "A recording, a deployment file, or the name of a shipped one.")],
    options: RunOptions,
    world: Annotated[
        WorldMode | None,
        option(
            "--world",
            help="With a deployment: its world is done again, or gives what was recorded. By default again, "
            "unless it has actuators.",
        ),
    ] = None,
) -> int:
    """Name the first epoch, node, operator and field in which two runs differ. Exit code 1 where they do.

    The other run is a recording, or a deployment that is given what the first one's nodes were given."""
    from hierax.runtime.recording.diff import compare

    recording = recording_of(file)
    if _is_recording(other):
        if options.overrides or world is not None:
            raise CommandError("--set and --world: only with a deployment as the other run")
        epochs: Iterable[EpochView] = recording_of(Path(other)).epochs(options.first, options.last)
    else:
        epochs = _replay(recording, other, world, options).epochs()
    with redirect_stdout(sys.stderr):
        comparison = compare(recording.epochs(options.first, options.last), epochs, options.tolerance)
    if not comparison.epochs:
        raise CommandError(f"{file} and {other}: there is no epoch that both have")
    if options.output_format is Format.json:
        print_json({"a": str(file), "b": other, **comparison_json(comparison)})
    else:
        print_comparison(comparison, str(file), other)
    return OK if comparison.alike else FAILED


def _replay(recording: "Recording", other: str, world: WorldMode | None, options: RunOptions) -> "Replay":
    """What does a recording's epochs with a deployment in the place of its own."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.loading.loader import extend_import_path
    from hierax.runtime.recording.replay import Replay, allowance_of, has_actuators, in_place_of

    deployment = read_deployment(other, options.overrides or ())
    extend_import_path(deployment.import_paths)
    rosters = recording.rosters()
    if not rosters:
        raise CommandError(f"{recording.path}: no roster is recorded, so there is no epoch to compare")
    again = world is WorldMode.again or (world is None and not has_actuators(deployment.roster, deployment.allowance))
    rewrite = in_place_of(rosters[min(rosters)], deployment)
    allowance = deployment.allowance  # what the recording names besides, after changes, is another matter
    if options.trust or recording.info.is_ours:
        allowance = allowance_of(recording, options.trust).with_modules(deployment.modules)
    return Replay(recording, allowance, world=again, rewrite=rewrite, first=options.first, last=options.last)


def _is_recording(name: str) -> bool:
    path = Path(name)
    if not path.is_file():
        if path.suffix == ".mcap":
            raise CommandError(f"{name}: there is no such recording")
        return False
    with path.open("rb") as file:
        return file.read(5) == b"\x89MCAP"
