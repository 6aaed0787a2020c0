"""``hierax attach``, ``detach``, ``replace`` and ``ps``: against a launch that runs."""

import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from hierax.runtime.commands.errors import CommandError, unhindered
from hierax.runtime.commands.options import SNIPPET, Format, Node, RunOptions, Snippet, argument, offers, option
from hierax.runtime.commands.show import RIGHT, by_process, print_json, print_table
from hierax.runtime.commands.which_launch import Meant, client_at, launch_meant, own_deployment
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.launch.run_file import is_loopback, known_runs

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.deployment.deployment import Document, ProcessTerms
    from hierax.runtime.launch.attached_processes import AttachedHere
    from hierax.schemas.roster import Attach, Change, Replace

WAIT_S = 60.0  # how long `ps --wait` waits
LOOK_S = 0.1
_EPOCH = re.compile("[0-9]{1,19}")


@offers("run", "connect", "key", "deployment_file", "trust", "output_format")
def attach(
    options: RunOptions,
    source: Annotated[str, argument("SOURCE", f"{SNIPPET}, or the name of a node of the deployment file.")],
    here: Annotated[bool, option("--here")] = False,
    host: Annotated[str | None, option("--host", help="With --here: this machine's address for the others.")] = None,
) -> int:
    """Attach nodes to a hierarchy that runs, and print the epoch at which they took effect."""
    from hierax.runtime.deployment.snippet import read_attaching

    if host is not None and not here:
        raise CommandError("--host: only with --here; the new processes come up where the launch runs")
    if here and host is None and options.connect is not None and not is_loopback(options.connect):
        raise CommandError("--here: the others have to reach the new processes: give this machine's address by --host")
    if options.trust and not here:
        raise CommandError("--trust: only with --here; without it nothing is loaded on this machine")
    launch = launch_meant(options.run, options.connect, options.key)
    own = own_deployment(launch, options.deployment_file) if here else None
    if here and own is None and not options.trust:
        raise CommandError(
            "--here: give the launch's deployment file by --deployment, as no launch of yours answers there: what runs "
            "here is what that file and SOURCE name; or --trust, to run whatever the launch names"
        )
    file = deployment_at(launch, options.deployment_file)
    change, terms, document = read_attaching(source, file)
    what = f"attached {', '.join(change.nodes)}"
    if not here:
        with _explaining(change, document):
            answer = ask_for(launch, change, terms)
        return print_epoch(answer, what, options.output_format)
    from hierax.runtime.launch.attached_processes import run_attached

    named = _here(source, change, own, options.trust, launch, host)
    with _explaining(change, document):
        offer = ask_for(launch, change, terms, here=True, host=named.host)
    request = offer.get("request")
    if not isinstance(request, str):
        raise CommandError(f"the launch at {launch.endpoint} gave no order, and no reason")

    def await_change() -> None:
        with _explaining(change, document):
            answer = _ask(launch, {"ask": "await", "request": request})
        print_epoch(answer, what, options.output_format)

    with unhindered() as tell:
        return run_attached(offer.get("orders"), request, named, terms, await_change, tell)


@offers("run", "connect", "key", "output_format")
def detach(node: Node, options: RunOptions, cascade: Annotated[bool, option("--cascade")] = False) -> int:
    """Detach a node from a hierarchy that runs, and print the epoch at which it took effect."""
    from hierax.schemas.roster import Detach

    answer = ask_for(launch_meant(options.run, options.connect, options.key), Detach(node, cascade), {})
    return print_epoch(answer, f"detached {node}", options.output_format)


@offers("run", "connect", "key", "deployment_file", "output_format")
def replace(node: Node, source: Snippet, options: RunOptions) -> int:
    """Let another class or other parameters take a node's place and belief, and print the epoch."""
    from hierax.runtime.deployment.snippet import read_replacing

    launch = launch_meant(options.run, options.connect, options.key)
    file = deployment_at(launch, options.deployment_file)
    change, terms, document = read_replacing(source, node, file)
    with _explaining(change, document):
        answer = ask_for(launch, change, terms)
    return print_epoch(answer, f"replaced {node}", options.output_format)


@offers("run", "connect", "key", "output_format")
def ps(options: RunOptions, wait: Annotated[str | None, option("--wait")] = None) -> int:
    """List the launches on this machine, and the processes of their nodes."""
    found, silent = _awaited(options, wait) if wait is not None else _runs(options)
    if options.output_format is Format.json:
        print_json({"runs": found})
    elif not found and not silent:
        print("no launch runs on this machine")
    else:
        _print_runs(found)
    if silent:
        raise CommandError(f"no answer from {', '.join(silent)}")
    return 0


def _awaited(options: RunOptions, what: str) -> tuple[list[dict[str, Any]], list[str]]:
    """What runs, when one of it has come to an epoch, or has a node."""
    from hierax.runtime.transport.launch_client import is_gone
    from hierax.runtime.transport.port import TransportError

    epoch = int(what) if _EPOCH.fullmatch(what) else None
    wanted = f"a node {what!r}" if epoch is None else f"committed epoch {what}"
    patience_s = time.monotonic() + WAIT_S
    seen: set[str] = set()
    while True:
        why = f"no launch has {wanted} within {WAIT_S:g} s"
        is_over = False
        try:
            found, silent = _runs(options)
            if any(what in each["nodes"] if epoch is None else each["epoch"] >= epoch for each in found):
                return found, silent
            seen.update(f"{each['hierarchy']}, run {each['run']}," for each in found)
            is_over = not found and not silent
        except HieraxError as error:  # it may come yet
            why = f"{why}: {error}"
            is_over = is_gone(options.connect) if options.connect is not None else not isinstance(error, TransportError)
        if seen and is_over:
            raise CommandError(f"{' '.join(sorted(seen))} is over; no launch has {wanted}")
        if time.monotonic() > patience_s:
            raise CommandError(why)
        time.sleep(LOOK_S)


def _runs(options: RunOptions) -> tuple[list[dict[str, Any]], list[str]]:
    """What runs, and the launches that do not answer."""
    from hierax.runtime.transport.launch_client import AnswerError

    if (options.run, options.connect, options.key) != (None, None, None):
        return [_status(launch_meant(options.run, options.connect, options.key))], []
    found: list[dict[str, Any]] = []
    silent: list[str] = []
    for running in known_runs():
        try:
            found.append(_status(Meant.here(running)))
        except HieraxError as error:  # noqa: PERF203 - each answers for itself
            if isinstance(error, AnswerError):
                raise
            if running in known_runs():  # else it is over since it was listed, and its key is gone
                silent.append(f"{running.run} ({running.hierarchy}, process {running.pid})")
    return found, silent


def _print_runs(runs: Sequence[Mapping[str, Any]]) -> None:
    for number, each in enumerate(runs):
        space = "\n" if number else ""
        print(f"{space}{each['hierarchy']}, run {each['run']}: epoch {each['epoch']}, roster version {each['roster']}")
        nodes = by_process(each["nodes"])
        shown = {"process": "shares", "node": "", "state": "state", "host": "host", "pid": "pid"}
        shown |= {"instance": "instance", "restarts": "restarts"}
        for column in ("process", "host"):
            if not any(node.get(shown[column]) for node in nodes.values()):
                del shown[column]
        rows = [
            tuple(name if not key else "" if node.get(key) is None else str(node[key]) for key in shown.values())
            for name, node in nodes.items()
        ]
        figures = ("pid", "instance", "restarts")
        print_table({column: RIGHT if column in figures else {} for column in shown}, rows)


def deployment_at(launch: Meant, file: str | None) -> "Deployment":
    """The deployment of a launch, read from a file, or from the one that the launch names."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.deployment.secrets import usable

    said = _ask(launch, {"ask": "ps"})
    named, settings = said.get("file"), said.get("settings")
    if (
        not isinstance(named, str)
        or not isinstance(settings, (list, tuple))
        or not all(isinstance(each, str) for each in settings)
    ):
        raise CommandError(f"the launch at {launch.endpoint} does not say which deployment file it has")
    return read_deployment(file or named, usable(settings))


def _status(launch: Meant) -> dict[str, Any]:
    """What a launch says that it runs. Raises `HieraxError` if there is no answer, or none that can be read."""
    from hierax.runtime.transport.launch_client import LaunchStatus

    said = _ask(launch, {"ask": "ps"})
    LaunchStatus.read(said)
    return said


def _here(
    source: str, change: "Attach", own: "Deployment | None", trust: bool, launch: Meant, host: str | None
) -> "AttachedHere":
    """What is decided on this machine about nodes kept here; `HieraxError` if code of the source may not be loaded."""
    from hierax.runtime.deployment.snippet import read_attach
    from hierax.runtime.launch.attached_processes import AttachedHere
    from hierax.runtime.loading.allowance import Allowance, module_of, references

    named = change if own is None else read_attach(source, own)
    modules = [module_of(reference.target) for _, reference in references(named)]
    allowance = Allowance(() if own is None else own.modules).with_modules(modules)
    allowance.check_all(change)
    import_paths = (str(Path.cwd()),) if own is None else own.import_paths
    settings = None if own is None else own.zenoh
    return AttachedHere(
        change.nodes, allowance, trust, import_paths, launch.endpoint, host or "", settings, launch.secret
    )


@contextmanager
def _explaining(change: "Attach | Replace", document: "Document") -> Iterator[None]:
    """Raise a launch's refusal of new nodes with its place in the document that has them, if it names a path there."""
    from hierax.runtime.transport.launch_client import AnswerError
    from hierax.schemas.roster import new_nodes

    try:
        yield
    except AnswerError as error:
        text = str(error)
        ends = (name for edge in change.edges or () for name in edge.pair)
        for name in dict.fromkeys((*new_nodes(change), *ends)):
            text = text.removeprefix(f"{name}: ")  # whose process it was: a neighbour's has functions of edges, too
        where, _, what = text.partition(": ")
        if not document.has_part(where):
            raise
        raise document.error(document.keys(where), what) from error


def _ask(launch: Meant, question: Mapping[str, Any]) -> dict[str, Any]:
    """Ask a launch in a session for that alone: one that is held is cut off where this machine has no time for it."""
    from hierax.runtime.transport.launch_client import CHANGE_TIMEOUT_S

    with client_at(launch) as client:
        return client.ask(dict(question), CHANGE_TIMEOUT_S)


def ask_for(
    launch: Meant, change: "Change", terms: "Mapping[str, ProcessTerms]", here: bool = False, host: str = ""
) -> dict[str, Any]:
    """Have a launch change; gives its answer when the change counts. Raises `HieraxError` if it is refused."""
    with client_at(launch) as client:
        return client.change(change, terms, here, host)


def print_epoch(answer: Mapping[str, Any], what: str, output_format: Format) -> int:
    """Say at which epoch a change took effect."""
    if output_format is Format.json:
        print_json({"epoch": answer["epoch"]})
    else:
        print(f"{what} at epoch {answer['epoch']}", flush=True)
    return 0
