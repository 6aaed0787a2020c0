"""``hierax check``: a recorded trace against the formal order."""

from __future__ import annotations

from hierax.runtime.commands.errors import CommandError
from hierax.runtime.commands.options import Format, OutputFormat, RecordingFile
from hierax.runtime.commands.recordings import recording_of, report_violations
from hierax.runtime.commands.show import print_json


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
        print_json({"file": str(file), "epochs": checker.epochs, "steps": checker.checked, "violations": found})
    elif not violations:
        print(f"{file}: {checker.epochs} epochs, {checker.checked} steps of nodes: the formal order is kept")
    return report_violations(violations)
