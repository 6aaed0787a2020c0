"""Which launch a command means, and how it is asked."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.errors import CommandError
from hierax.runtime.core.errors import HieraxError

if TYPE_CHECKING:
    from hierax.runtime.launch.run_file import Running
    from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus

_ENDPOINT = re.compile(r"[a-z]+/.+:[0-9]+")


def _runs_here() -> list[tuple[str, str]]:
    """Give, for completion, the launches that run on this machine, and what they run."""
    from hierax.runtime.launch.run_file import known_runs

    return [(each.run, each.hierarchy) for each in known_runs()]


Run = Annotated[
    str | None,
    typer.Option(
        "--run",
        metavar="RUN",
        help="Which launch: its identification, or how that begins, or its hierarchy's name; `hierax ps` lists them.",
        autocompletion=_runs_here,
    ),
]
Connect = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="The launch on another machine: the endpoint that `hierax launch --host` prints.",
    ),
]


def endpoint_of(run: str | None, connect: str | None) -> str:
    """Where the launch is reached that is meant.

    Raises:
        CommandError: there is none, or several; or an option is wrong.
    """
    from hierax.runtime.host.run_folder import meant
    from hierax.runtime.launch.run_file import known_runs
    from hierax.runtime.loading.nearest import did_you_mean

    if connect is not None:
        if not _ENDPOINT.fullmatch(connect):
            raise CommandError(f"--connect: expected an endpoint such as tcp/192.168.1.2:40123, got {connect!r}")
        return connect
    runs = known_runs()
    found = runs if run is None else meant(run, runs, lambda each: (each.run, each.hierarchy))
    if len(found) > 1:
        which = "" if run is None else f" of {run!r}"
        raise CommandError(f"several launches{which} run on this machine, say which with --run: {_listed(found)}")
    if found:
        return found[0].endpoint
    if run is None:
        raise CommandError("no launch runs on this machine")
    near = did_you_mean(run, [name for each in runs for name in (each.run, each.hierarchy)], "there are")
    raise CommandError(f"no launch {run!r} runs on this machine{near}")


def _listed(runs: Sequence[Running]) -> str:
    return ", ".join(f"{each.run} ({each.hierarchy})" for each in runs)


def known_run(endpoint: str) -> Running | None:
    """The launch at an endpoint, where it runs on this machine and is this user's."""
    from hierax.runtime.launch.run_file import known_runs

    return next((each for each in known_runs() if each.endpoint == endpoint), None)


def client_at(endpoint: str, running: Running | None = None) -> LaunchClient:
    """A client of the launch at an endpoint; of one that is known here, on the keys of that run alone.

    Raises:
        TransportError: it cannot be reached.
    """
    from hierax.runtime.transport import launch_client
    from hierax.schemas.keys import Keys

    running = running or known_run(endpoint)
    keys = None if running is None else Keys(running.hierarchy, running.run)
    return launch_client.LaunchClient(endpoint, keys=keys)


def client_of(run: str | None, connect: str | None) -> LaunchClient:
    """A client of the launch that is meant.

    Raises:
        CommandError: there is none, or several; or an option is wrong.
        TransportError: it cannot be reached.
    """
    return client_at(endpoint_of(run, connect))


def _clients() -> Iterator[tuple[LaunchClient, LaunchStatus]]:
    """Give, for completion, the launches on this machine that answer."""
    from hierax.runtime.launch.run_file import known_runs

    for running in known_runs():
        with suppress(HieraxError), client_at(running.endpoint, running) as client:  # it may have ended just now
            yield client, client.status()


def nodes_here() -> list[str]:
    """Give, for completion, the nodes of the launches on this machine."""
    return sorted({name for _, status in _clients() for name in status.nodes})


def keys_here() -> list[str]:
    """Give, for completion, the keys of the launches on this machine."""
    from hierax.runtime.tools.echoes import edges_of, short_key

    return sorted({short_key(edge) for client, status in _clients() for edge in edges_of(client.edges(status))})


NodeArgument = Annotated[str, typer.Argument(metavar="NODE", help="A node's name.", autocompletion=nodes_here)]
