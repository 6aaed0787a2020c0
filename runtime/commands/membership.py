"""``hierax attach``, ``detach``, ``replace`` and ``ps``: against a launch that runs."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from hierax.runtime.commands.errors import CommandError, notify
from hierax.runtime.commands.options import SNIPPET, Format, Node, RunOptions, Snippet, argument, offers, option
from hierax.runtime.commands.show import RIGHT, print_json, print_table
from hierax.runtime.commands.which_launch import client_at, endpoint_of, own_deployment
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.launch.run_file import known_runs

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.deployment.deployment import RestartPolicy
    from hierax.runtime.launch.attached_processes import AttachedHere
    from hierax.schemas.roster import Attach, Change

_LOOPBACK = re.compile(r"[a-z]+/(127\.|localhost|\[::1\])")
WAIT_S = 60.0  # how long `ps --wait` waits
LOOK_S = 0.1


@offers("run", "connect", "deployment_file", "trust", "output_format")
def attach(
    options: RunOptions,
    source: Annotated[str, argument("SOURCE", f"{SNIPPET}, or the name of a node of the deployment file.")],
    here: Annotated[bool, option("--here")] = False,
    host: Annotated[str | None, option("--host", help="With --here: this machine's address for the others.")] = None,
) -> int:
    """Attach nodes to a hierarchy that runs, and print the epoch at which they took effect."""
    from hierax.runtime.deployment.snippet import read_attach, read_restarts

    if host is not None and not here:
        raise CommandError("--host: only with --here; the new processes come up where the launch runs")
    if here and host is None and options.connect is not None and not _LOOPBACK.match(options.connect):
        raise CommandError("--here: the others have to reach the new processes: give this machine's address by --host")
    if options.trust and not here:
        raise CommandError("--trust: only with --here; without it nothing is loaded on this machine")
    endpoint = endpoint_of(options.run, options.connect)
    own = own_deployment(endpoint, options.deployment_file) if here else None
    if here and own is None and not options.trust:
        raise CommandError(
            "--here: give the launch's deployment file by --deployment, as no launch of yours answers there: what runs "
            "here is what that file and SOURCE name; or --trust, to run whatever the launch names"
        )
    file = deployment_at(endpoint, options.deployment_file)
    change = read_attach(source, file)
    restarts = read_restarts(source, file, attached=True)
    what = f"attached {', '.join(change.nodes)}"
    if not here:
        return print_epoch(ask_for(endpoint, change, restarts), what, options.output_format)
    from hierax.runtime.launch.attached_processes import run_attached

    named = _here(source, change, own, options.trust, endpoint, host)
    offer = ask_for(endpoint, change, restarts, here=True, host=named.host)
    request = offer.get("request")
    if not isinstance(request, str):
        raise CommandError(f"the launch at {endpoint} gave no order, and no reason")

    def await_change() -> None:
        print_epoch(_ask(endpoint, {"ask": "await", "request": request}), what, options.output_format)

    return run_attached(offer.get("orders"), request, named, restarts, await_change, notify)


@offers("run", "connect", "output_format")
def detach(node: Node, options: RunOptions, cascade: Annotated[bool, option("--cascade")] = False) -> int:
    """Detach a node from a hierarchy that runs, and print the epoch at which it took effect."""
    from hierax.schemas.roster import Detach

    answer = ask_for(endpoint_of(options.run, options.connect), Detach(node, cascade), {})
    return print_epoch(answer, f"detached {node}", options.output_format)


@offers("run", "connect", "deployment_file", "output_format")
def replace(node: Node, source: Snippet, options: RunOptions) -> int:
    """Let another class or other parameters take a node's place and belief, and print the epoch."""
    from hierax.runtime.deployment.snippet import read_replace, read_restarts

    endpoint = endpoint_of(options.run, options.connect)
    file = deployment_at(endpoint, options.deployment_file)
    answer = ask_for(endpoint, read_replace(source, node, file), read_restarts(source, file))
    return print_epoch(answer, f"replaced {node}", options.output_format)


@offers("run", "connect", "output_format")
def ps(options: RunOptions, wait: Annotated[str | None, option("--wait")] = None) -> int:
    """List the launches on this machine, and the processes of their nodes."""
    run, connect = options.run, options.connect
    found, silent = _awaited(run, connect, wait) if wait is not None else _runs(run, connect)
    if options.output_format is Format.json:
        print_json({"runs": found})
    elif not found and not silent:
        print("no launch runs on this machine")
    else:
        _print_runs(found)
    if silent:
        raise CommandError(f"no answer from {', '.join(silent)}")
    return 0


def _awaited(run: str | None, connect: str | None, what: str) -> tuple[list[dict[str, Any]], list[str]]:
    """What runs, when one of it has come to an epoch, or has a node."""
    from hierax.runtime.transport.launch_client import is_gone
    from hierax.runtime.transport.port import TransportError

    wanted = f"committed epoch {what}" if what.isdigit() else f"a node {what!r}"
    patience_s = time.monotonic() + WAIT_S
    seen: set[str] = set()
    while True:
        why = f"no launch has {wanted} within {WAIT_S:g} s"
        is_over = False
        try:
            found, silent = _runs(run, connect)
            if any(each["epoch"] >= int(what) if what.isdigit() else what in each["nodes"] for each in found):
                return found, silent
            seen.update(f"{each['hierarchy']}, run {each['run']}," for each in found)
            is_over = not found and not silent
        except HieraxError as error:  # it may come yet
            why = f"{why}: {error}"
            is_over = is_gone(connect) if connect is not None else not isinstance(error, TransportError)
        if seen and is_over:
            raise CommandError(f"{' '.join(sorted(seen))} is over; no launch has {wanted}")
        if time.monotonic() > patience_s:
            raise CommandError(why)
        time.sleep(LOOK_S)


def _runs(run: str | None, connect: str | None) -> tuple[list[dict[str, Any]], list[str]]:
    """What runs, and the launches that do not answer."""
    from hierax.runtime.transport.port import TransportError

    if run is not None or connect is not None:
        return [_ask(endpoint_of(run, connect), {"ask": "ps"})], []
    found: list[dict[str, Any]] = []
    silent: list[str] = []
    for running in known_runs():
        try:
            found.append(_ask(running.endpoint, {"ask": "ps"}))
        except TransportError:  # noqa: PERF203 - each answers for itself
            if running.alive:  # else it is over since it was listed
                silent.append(f"{running.run} ({running.hierarchy}, process {running.pid})")
    return found, silent


def _print_runs(runs: Sequence[Mapping[str, Any]]) -> None:
    for number, each in enumerate(runs):
        space = "\n" if number else ""
        print(f"{space}{each['hierarchy']}, run {each['run']}: epoch {each['epoch']}, roster version {each['roster']}")
        rows = [
            (name, node["state"], str(node["pid"] or ""), str(node["instance"]), str(node["restarts"]))
            for name, node in each["nodes"].items()
        ]
        print_table({"node": {}, "state": {}, "pid": RIGHT, "instance": RIGHT, "restarts": RIGHT}, rows)


def deployment_at(endpoint: str, file: str | None) -> Deployment:
    """The deployment of a launch, read from a file, or from the one that the launch names."""
    from hierax.runtime.deployment.read import read_deployment

    said = _ask(endpoint, {"ask": "ps"})
    return read_deployment(file or said["file"], said["settings"])


def _here(
    source: str, change: Attach, own: Deployment | None, trust: bool, endpoint: str, host: str | None
) -> AttachedHere:
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
    return AttachedHere(change.nodes, allowance, trust, import_paths, endpoint, host or "", settings)


def _ask(endpoint: str, question: Mapping[str, Any]) -> dict[str, Any]:
    """Ask a launch in a session for that alone: one that is held is cut off where this machine has no time for it."""
    from hierax.runtime.transport.launch_client import CHANGE_TIMEOUT_S

    with client_at(endpoint) as client:
        return client.ask(dict(question), CHANGE_TIMEOUT_S)


def ask_for(
    endpoint: str, change: Change, restarts: Mapping[str, RestartPolicy], here: bool = False, host: str = ""
) -> dict[str, Any]:
    """Have a launch change; gives its answer when the change counts. Raises `HieraxError` if it is refused."""
    with client_at(endpoint) as client:
        return client.change(change, restarts, here, host)


def print_epoch(answer: Mapping[str, Any], what: str, output_format: Format) -> int:
    """Say at which epoch a change took effect."""
    if output_format is Format.json:
        print_json({"epoch": answer["epoch"]})
    else:
        print(f"{what} at epoch {answer['epoch']}", flush=True)
    return 0
