"""``hierax launch``: a deployment, each node in a process of its own, or in those that it shares."""

import functools
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hierax.runtime.commands.checks import check_zenoh
from hierax.runtime.commands.errors import OK, CommandError, notify, unhindered
from hierax.runtime.commands.options import OF_A_RUN, LaunchedFile, RunOptions, offers
from hierax.runtime.commands.recordings import claimed_file, recording_of, report_outcome, selection_of
from hierax.runtime.host.private_files import check_encodable
from hierax.runtime.launch.run_file import Run, has_run, read_run

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.execution.report import Report
    from hierax.runtime.launch.fork_server import ForkServer


@offers(*OF_A_RUN, "state", "resume", "host", "sync", "processes", "traffic", "trust")
def launch(options: RunOptions, file: LaunchedFile = None) -> int:
    """Run a deployment with each node in a process of its own, or in those that it shares, over Zenoh."""
    from hierax.runtime.launch.fork_server import ForkServer

    with ForkServer().start() as forks:  # it imports while this process does
        if file is None or options.resume is None:
            return _launched(options, file, forks)
        return _begun_or_resumed(options, file, options.resume, forks)


def _begun_or_resumed(options: RunOptions, file: str, state: Path, forks: "ForkServer") -> int:
    """Go on with the run in a folder; where there is none, it begins there, and one that is over stays so."""
    from hierax.runtime.launch.orders import NotBegunError, OverError

    if options.state is not None:
        raise CommandError("--resume with --state: name one folder")
    anew = replace(options, state=state, resume=None, trust=False)
    if not has_run(state):
        return _launched(anew, file, forks)
    try:
        return _launched(replace(options), file, forks)
    except OverError as over:
        notify(str(over))
        return OK
    except NotBegunError:
        return _launched(anew, file, forks, goes_on=True)


def _launched(options: RunOptions, file: str | None, forks: "ForkServer", goes_on: bool = False) -> int:
    """`goes_on`: whether the output of a run that was ended before its first epoch is written on, its state anew."""
    from hierax.runtime.commands.run_deployment import run_deployment
    from hierax.runtime.launch.recorder_process import RecordingRequest
    from hierax.runtime.transport.zenoh_session import log_refusals
    from hierax.runtime.watch import refused, telemetry

    telemetry.wanted()  # what is wrong there is told once, not by every process
    run = _resumed(file, options)
    file = file if run is None else run.deployment
    if file is None:
        raise CommandError("expected a deployment file, or --resume DIR")
    output, state = options.output, options.state
    check_encodable(state or "")
    if options.traffic is not None and options.processes is None:
        raise CommandError("--traffic: only with --processes, whose cut it decides")
    selection = selection_of(options, options.record is not None)
    with claimed_file(options.record, options.overwrite) as target, unhindered() as tell:
        recording = RecordingRequest(target, options.check, selection) if target or options.check else None
        runner = functools.partial(
            _placed,
            options,
            notify=tell,
            state=None if state is None else state.absolute(),
            resumed=run,
            host=options.host,
            overrides=tuple(options.overrides or ()),
            overwrite=options.overwrite or goes_on,
            recording=recording,
            forks=forks,
        )
        if run is not None and output is not None:
            goes_on = bool(run.output) and output.resolve() == Path(run.output).resolve()
        log_refusals()
        with refused.watched(tell):
            code = run_deployment(runner, file, options, goes_on)
    if recording is None:
        return code
    if recording.failure:
        raise CommandError(recording.failure)
    return max(code, report_outcome(recording.file, recording.ending, recording.violations))


def _placed(options: RunOptions, deployment: "Deployment", **given: Any) -> "Report":
    """Launch a deployment, in so many processes and with its folder on all hosts where that is said."""
    from hierax.runtime.deployment.hosts import check_together
    from hierax.runtime.deployment.partition import cut
    from hierax.runtime.launch import supervisor
    from hierax.runtime.launch.folder_copy import copied

    check_zenoh(deployment)
    processes, traffic = options.processes, options.traffic
    if processes is not None:
        passed = None if traffic is None else _traffic(traffic, deployment)
        deployment = replace(deployment, processes=cut(deployment.roster, processes, passed))
        if apart := check_together(deployment.processes, deployment.placed):
            raise CommandError(f"--processes: {apart}; name them under `processes` of the file")
    if options.sync:
        own = (options.state, options.output, options.record)
        deployment = copied(deployment, [path for path in own if path is not None], notify)
    return supervisor.launch(deployment, **given)


def _traffic(file: Path, deployment: "Deployment") -> dict[tuple[str, str], float]:
    """How many bytes passed along the edges of a hierarchy, by lower and upper node, in a recording.

    Raises `HieraxError` if it cannot be read, or has nothing of them."""
    from hierax.runtime.recording.topics import MESSAGE

    bytes_along = dict.fromkeys(deployment.roster.pairs, 0.0)
    for entry in recording_of(file).entries(MESSAGE):
        sender, receiver = entry.topic.names
        for pair in ((sender, receiver), (receiver, sender)):
            if pair in bytes_along:
                bytes_along[pair] += len(entry.data)
    if not any(bytes_along.values()):
        raise CommandError(f"--traffic: {file} has no messages along the edges of {deployment.name}")
    return bytes_along


def _resumed(file: str | None, options: RunOptions) -> Run | None:
    """The run that is resumed, whose own options are taken over where others are not given; None: a new one begins."""
    from hierax.runtime.deployment.deployment import find_file
    from hierax.runtime.deployment.secrets import completed

    if options.resume is None:
        if options.trust:
            raise CommandError("--trust: only with --resume; a deployment file that you name is yours to judge")
        return None
    if options.state is not None:
        raise CommandError("--resume: the run knows its folder; --state is for another one")
    run = read_run(options.resume, options.trust)
    if file is not None and find_file(file).resolve() != Path(run.deployment):
        raise CommandError(f"--resume {options.resume}: the run there is one of {run.deployment}, not of {file}")
    given = [text for text in options.overrides or () if file is None or text not in run.settings]
    options.state, options.seed = options.resume, run.seed
    options.overrides = list(completed(run.settings, given))
    options.epochs = run.epochs if options.epochs is None else options.epochs
    options.output = options.output or (Path(run.output) if run.output else None)
    return run
