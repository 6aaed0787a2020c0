"""``hierax view``: what the nodes of a launch, a recording or a run in this process believe, in Rerun."""

import importlib.util
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.ctrl_c import CTRL_C, INTERRUPTED
from hierax.runtime.commands.errors import OK, CommandError, interrupted, notify
from hierax.runtime.commands.options import RunOptions, offers
from hierax.runtime.commands.which_launch import client_at, launch_meant, own_deployment
from hierax.runtime.core.errors import HieraxError

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.viewing.presenter import ViewPresenter
    from hierax.runtime.viewing.viewer import Place, Stream

RECORDING_SUFFIX = ".mcap"

Over = Callable[[], bool]  # whether nobody can see any more
Show = Callable[["ViewPresenter", Over], None]

Shown = Annotated[
    str | None,
    typer.Argument(
        metavar="FILE",
        help="A recording (.mcap); or a deployment file, or the name of a shipped deployment, which is then run in "
        "this process. None: the launch that runs on this machine.",
    ),
]


@offers(
    *("epochs", "seed", "overrides", "overwrite", "run", "connect", "key", "native", "save"),
    *("port", "deployment_file", "opens", "memory", "first", "last", "trust"),
)
def view(options: RunOptions, source: Shown = None) -> int:
    """See what the nodes believe: of a launch that runs, a recording, or a run in this process."""
    if importlib.util.find_spec("rerun") is None:
        raise CommandError("hierax view needs Rerun, the extra [view]: pip install 'hierax[view]'")
    if options.native and options.save is not None:
        raise CommandError("--native and --save: give one of them")
    if source is not None and not (options.run is options.connect is options.deployment_file is None):
        raise CommandError("give a file, or say which launch is meant: not both")
    _check_used(source, options)
    if source is None:
        deployment, hierarchy, show = _of_launch(options)
    elif source.endswith(RECORDING_SUFFIX):
        deployment, hierarchy, show = _of_recording(Path(source), options)
    else:
        deployment, hierarchy, show = _of_deployment(source, options)
    from hierax.runtime.viewing.viewer import stream_of

    stream, code = stream_of(hierarchy), OK
    with _viewer(stream, options) as place:
        endless = source is None
        try:
            if options.save is None:
                notify(f"seen at {place.name}")
            with nullcontext() if deployment is None else deployment.explaining():
                show(_presenter(deployment, stream), place.ended)
            if place.until_closed is not None and not place.ended():
                endless = True
                notify("that is all; Ctrl-C ends the viewer")
                place.until_closed()
        except KeyboardInterrupt:
            if not endless and options.save is None:
                raise
            CTRL_C.taken()  # what was drawn until then is kept, and the viewer closed, however long it takes
            if endless:
                notify("no longer looking")
            else:
                code = INTERRUPTED
    if options.save is not None:  # now it is there
        notify(f"seen at {options.save}")
    return interrupted() if code == INTERRUPTED else code


def _check_used(source: str | None, options: RunOptions) -> None:
    """Raises `CommandError` if an option is given that does nothing for what is shown, or where."""
    is_recording = source is not None and source.endswith(RECORDING_SUFFIX)
    if source is None or is_recording:
        _refuse(options, "only with a deployment", overrides="--set", seed="--seed", epochs="--epochs")
    if not is_recording:
        _refuse(options, "only with a recording", first="--from", last="--to")
    if options.save is not None:
        _refuse(options, "not with --save, which starts no viewer", port="--port", opens="--open", memory="--memory")
    elif options.native:
        _refuse(options, "not with --native, which serves no page", port="--port", opens="--open")


def _refuse(options: RunOptions, why: str, **names: str) -> None:
    """Raises `CommandError` if one of these options, by their fields, has been given."""
    unsaid = RunOptions()
    for field, name in names.items():
        if getattr(options, field) not in (getattr(unsaid, field), []):
            raise CommandError(f"{name}: {why}")


Source = tuple["Deployment | None", str, Show]
"""The deployment as far as it is known, the hierarchy's name, and what shows it."""


def _of_deployment(source: str, options: RunOptions) -> Source:
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.viewing.live import run_seen

    deployment = read_deployment(source, options.overrides or ())
    probes = tuple(replace(each, overwrite=options.overwrite) for each in deployment.probes)
    deployment = replace(deployment, probes=probes)

    def show(presenter: "ViewPresenter", over: Over) -> None:
        with redirect_stdout(sys.stderr):
            run_seen(deployment, presenter, epochs=options.epochs, seed=options.seed)

    return deployment, deployment.name, show


def _of_recording(file: Path, options: RunOptions) -> Source:
    from hierax.runtime.recording.reading import Recording
    from hierax.runtime.recording.replay import allowance_of, recorded_deployment
    from hierax.runtime.viewing.recorded_run import show_recording

    recording = Recording.open(file)
    allowance = allowance_of(recording, options.trust)

    first, last = options.first, options.last

    def show(presenter: "ViewPresenter", over: Over) -> None:
        if not show_recording(recording, presenter, allowance, first, last):
            why = f": {recording.loss}" if recording.loss else ""
            raise CommandError(f"{file}: there is no committed epoch in it from {first} to {last or 'its end'}{why}")
        if recording.loss:
            notify(f"{file}: {recording.loss}")

    return recorded_deployment(recording.info), recording.info.hierarchy, show


def _of_launch(options: RunOptions) -> Source:
    from hierax.runtime.loading.allowance import ANYTHING
    from hierax.runtime.viewing.live import show_launch

    launch = launch_meant(options.run, options.connect, options.key)
    deployment: Deployment | None = None
    try:
        deployment = own_deployment(launch, options.deployment_file)
    except HieraxError as error:
        notify(f"the layout is not that of the deployment, whose file cannot be read any more: {error}")

    if deployment is None and not options.trust:
        raise CommandError(
            "no more is known of that launch than it says itself: give its deployment file by --deployment, as what "
            "is loaded here is what that file names; or --trust, to load whatever the launch names"
        )
    allowance = ANYTHING if deployment is None or options.trust else deployment.allowance

    def show(presenter: "ViewPresenter", over: Over) -> None:
        with client_at(launch) as client, redirect_stdout(sys.stderr):
            show_launch(client, presenter, allowance, over)

    return deployment, "launch" if launch.running is None else launch.running.hierarchy, show


def _viewer(stream: "Stream", options: RunOptions) -> "AbstractContextManager[Place]":
    from hierax.runtime.viewing.viewer import file, web_viewer, window

    if options.save is not None:
        return file(stream, options.save, options.overwrite)
    if options.native:
        return window(stream, options.memory)
    return web_viewer(stream, options.port, options.memory, options.opens)


def _presenter(deployment: "Deployment | None", stream: "Stream") -> "ViewPresenter":
    from hierax.runtime.loading.loader import extend_import_path, load_function
    from hierax.runtime.viewing.presenter import ViewPresenter
    from hierax.runtime.viewing.rerun_canvas import RerunCanvas

    canvas = RerunCanvas(stream)
    if deployment is None:
        return ViewPresenter(canvas, notify=notify)
    extend_import_path(deployment.import_paths)
    spec = deployment.view
    together = None if spec.show is None else load_function(spec.show, "view.show", deployment.allowance)
    return ViewPresenter(canvas, spec.layout, together, notify)
