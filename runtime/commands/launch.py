"""``hierax launch``: a deployment, each node in a process of its own."""

import functools
from pathlib import Path

from hierax.runtime.commands.errors import CommandError, notify
from hierax.runtime.commands.options import OF_A_RUN, LaunchedFile, RunOptions, offers
from hierax.runtime.commands.recordings import claimed_file, report_outcome, selection_of
from hierax.runtime.launch.run_file import Run, read_run


@offers(*OF_A_RUN, "state", "resume", "host", "trust")
def launch(options: RunOptions, file: LaunchedFile = None) -> int:
    """Run a deployment with each node in a process of its own, over Zenoh."""
    from hierax.runtime.commands.run_deployment import run_deployment
    from hierax.runtime.launch import supervisor
    from hierax.runtime.launch.recorder_process import RecordingRequest
    from hierax.runtime.transport.zenoh_session import log_who_comes
    from hierax.runtime.watch import doors, telemetry

    telemetry.wanted()  # what is wrong there is told once, not by every process
    run = _resumed(file, options)
    file = file if run is None else run.deployment
    if file is None:
        raise CommandError("expected a deployment file, or --resume DIR")
    output, state = options.output, options.state
    selection = selection_of(options, options.record is not None)
    with claimed_file(options.record, options.overwrite) as target:
        recording = RecordingRequest(target, options.check, selection) if target or options.check else None
        runner = functools.partial(
            supervisor.launch,
            notify=notify,
            state=None if state is None else state.absolute(),
            resumed=run,
            host=options.host,
            overrides=tuple(options.overrides or ()),
            recording=recording,
        )
        goes_on = run is not None and output is not None and output.absolute() == Path(run.output).absolute()
        log_who_comes()
        with doors.watched(notify):
            code = run_deployment(runner, file, options, goes_on)
    if recording is None:
        return code
    if recording.failure:
        raise CommandError(recording.failure)
    return max(code, report_outcome(recording.file, recording.ending, recording.violations))


def _resumed(file: str | None, options: RunOptions) -> Run | None:
    """The run that is resumed, whose own options are taken over where others are not given; None: a new one begins."""
    from hierax.runtime.deployment.secrets import completed

    if options.resume is None:
        if options.trust:
            raise CommandError("--trust: only with --resume; a deployment file that you name is yours to judge")
        return None
    if file is not None or options.state is not None:
        raise CommandError("--resume: the run knows its deployment file and folder; give neither")
    run = read_run(options.resume, options.trust)
    options.state, options.seed = options.resume, run.seed
    options.overrides = list(completed(run.settings, options.overrides or ()))
    options.epochs = run.epochs if options.epochs is None else options.epochs
    options.output = options.output or (Path(run.output) if run.output else None)
    return run
