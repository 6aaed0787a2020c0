"""``hierax inspect``: what a node of a launch, or of a recording, believes, and why."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from hierax.runtime.commands.errors import CommandError, notify
from hierax.runtime.commands.options import Format, Full, Node, RunOptions, argument, offers, option
from hierax.runtime.commands.recordings import recording_of
from hierax.runtime.commands.show import print_json
from hierax.runtime.commands.which_launch import Meant, client_at, launch_meant, own_deployment
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import printable

if TYPE_CHECKING:
    from hierax.runtime.execution.report import Json
    from hierax.runtime.transport.launch_client import Answer

    Told = Mapping[str, Mapping[str, str | float]]

_UNSAID = ("process", "before")  # of what a node answers


@offers("run", "connect", "key", "trust", "output_format")
def inspect(
    node: Node,
    options: RunOptions,
    file: Annotated[Path | None, argument("FILE", "A recording, in place of a launch.", dir_okay=False)] = None,
    epoch: Annotated[int | None, option("--epoch", min=1)] = None,
    full: Full = False,
) -> int:
    """Show what a node has observed, believes, was told from above and does, after its last epoch, and why."""
    if file is None and (epoch is not None or options.trust):
        raise CommandError("--epoch and --trust are for recordings")
    if file is not None and not options.run is options.connect is None:
        raise CommandError("give a recording, or say which launch is meant: not both")
    seen = _of_launch(node, options) if file is None else _of_recording(node, file, epoch, options.trust)
    named, answer, told = seen
    if options.output_format is Format.json:
        print_json(as_json(*named, node, {**answer, "shows": told}, full))
    else:
        _print(*named, node, answer, told)
    return 0


def _of_launch(node: str, options: RunOptions) -> "tuple[tuple[str, str], Answer, Told]":
    """The hierarchy and the run; what a node of a launch answers; and what it shows."""
    launch = launch_meant(options.run, options.connect, options.key)
    with client_at(launch) as client:
        status = client.status()
        answer = client.node_state(status, node)
    return (status.hierarchy, status.run), answer, _told(launch, node, answer) if "sensed" in answer else {}


def _told(launch: Meant, node: str, answer: "Answer") -> "Told":
    """What a node of a launch on this machine shows; nothing where it is another one than its deployment file has."""
    from hierax.runtime.core.node import class_name
    from hierax.runtime.core.probe import Step
    from hierax.runtime.loading.loader import build_node, extend_import_path
    from hierax.runtime.viewing.recorded_run import Look

    try:
        deployment = own_deployment(launch, None)
        if deployment is None or node not in deployment.roster.nodes:
            return {}
        roster = deployment.roster
        extend_import_path(deployment.import_paths)
        built = build_node(roster.nodes[node], f"nodes.{node}", deployment.allowance, node == roster.world)
        if class_name(built) != answer["class"]:
            return {}
        step = Step(*(answer[name] for name in Step._fields))
        return Look(node, built, step, answer["before"]).told()
    except HieraxError as error:
        notify(f"what {node} shows is not told: {error}")
        return {}


def _of_recording(node: str, file: Path, epoch: int | None, trust: bool) -> "tuple[tuple[str, str], Answer, Told]":
    """The same of a recording."""
    from hierax.runtime.core.node import class_name
    from hierax.runtime.loading.loader import extend_import_path
    from hierax.runtime.recording.replay import allowance_of, recorded_deployment
    from hierax.runtime.viewing.recorded_run import recorded_look

    recording = recording_of(file)
    allowance = allowance_of(recording, trust)
    extend_import_path(recorded_deployment(recording.info).import_paths)
    look, roster = recorded_look(recording, node, epoch, allowance)
    about = {"below": roster.below(node), "above": roster.above(node), "committed": True}
    answer = {"class": class_name(look.node), **about, "policies": (look.step.policy,), **look.step._asdict()}
    return (recording.info.hierarchy, recording.info.run), answer, look.told()


def as_json(hierarchy: str, run: str, node: str, answer: "Answer", full: bool = False) -> "dict[str, Json]":
    from hierax.runtime.execution.report import plain

    told = {key: plain(value, full) for key, value in answer.items() if key not in _UNSAID}
    return {"hierarchy": hierarchy, "run": run, "node": node, **told}


def _print(hierarchy: str, run: str, node: str, answer: Mapping[str, Any], told: "Told") -> None:
    from hierax.runtime.tools.summary import tree

    for line in _about(hierarchy, run, node, answer):
        print(printable(line, kept=""))
    for what in ("observations", "sensed", "tasks", "context", "actions", "belief"):
        if what in answer:
            print("\n".join(tree(answer[what], what)))
    for view, things in told.items():
        figures = {label: each for label, each in things.items() if not isinstance(each, str)}
        if figures:
            print("\n".join(tree(figures, f"shows {view}")))
        for text in (each for each in things.values() if isinstance(each, str)):
            print(f"\n{printable(text)}")


def _about(hierarchy: str, run: str, node: str, answer: Mapping[str, Any]) -> Iterator[str]:
    """What a node is, line by line."""
    counts = {True: "committed", False: "not committed yet", None: "epochs overlap"}[answer["committed"]]
    yield f"{node} of {hierarchy}, run {run}: after epoch {answer['epoch']} ({counts})"
    yield f"class  {answer['class']}"
    for where in ("below", "above"):
        yield f"{where}  {', '.join(answer[where]) or 'nothing'}"
    yield f"policy  {answer['policy']} (of {', '.join(answer['policies'])})"
