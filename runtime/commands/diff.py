"""``hierax diff``: the first place where two runs differ."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hierax.runtime.commands.errors import FAILED, OK, CommandError
from hierax.runtime.commands.options import Format, RecordingFile, RunOptions, WorldMode, argument, offers, option
from hierax.runtime.commands.recordings import comparison_json, print_comparison, recording_of
from hierax.runtime.commands.show import print_json

if TYPE_CHECKING:
    from hierax.runtime.recording.diff import EpochView
    from hierax.runtime.recording.reading import Recording
    from hierax.runtime.recording.replay import Replay


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


def _replay(recording: Recording, other: str, world: WorldMode | None, options: RunOptions) -> Replay:
    """What does a recording's epochs with a deployment in the place of its own."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.loading.loader import extend_import_path
    from hierax.runtime.recording.deployments import allowance_of, in_place_of
    from hierax.runtime.recording.replay import Replay, has_actuators

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
