"""Which launch a command means, and how it is asked."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from hierax.runtime.commands.errors import CommandError
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_folder import meant
from hierax.runtime.launch.run_file import Running, known_runs
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.keys import Keys

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus

_ENDPOINT = re.compile(r"[a-z]+/.+:[0-9]+")


def runs_here() -> list[tuple[str, str]]:
    """Give, for completion, the launches that run on this machine, and what they run."""
    return [(each.run, each.hierarchy) for each in known_runs()]


def endpoint_of(run: str | None, connect: str | None) -> str:
    """Where the launch is reached that is meant. Raises `CommandError` if there is none, or several may be meant."""
    if connect is not None:
        if not _ENDPOINT.fullmatch(connect):
            raise CommandError(f"--connect: expected an endpoint such as tcp/192.168.1.2:40123, got {connect!r}")
        return connect
    runs = known_runs()
    found = runs if run is None else meant(run, runs, lambda each: (each.run, each.hierarchy))
    if len(found) > 1:
        which = "" if run is None else f" of {run!r}"
        listed = ", ".join(f"{each.run} ({each.hierarchy})" for each in found)
        raise CommandError(f"several launches{which} run on this machine, say which with --run: {listed}")
    if found:
        return found[0].endpoint
    if run is None:
        raise CommandError("no launch runs on this machine")
    near = did_you_mean(run, [name for each in runs for name in (each.run, each.hierarchy)], "there are")
    raise CommandError(f"no launch {run!r} runs on this machine{near}")


def known_run(endpoint: str) -> Running | None:
    """The launch at an endpoint, where it runs on this machine and is this user's."""
    return next((each for each in known_runs() if each.endpoint == endpoint), None)


def own_deployment(endpoint: str, file: str | None) -> Deployment | None:
    """The deployment of a launch as its user on this machine knows it; None: no more is known than the launch says."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.deployment.secrets import usable

    running = known_run(endpoint)
    if running is not None:
        return read_deployment(file or running.deployment, usable(running.settings))
    return None if file is None else read_deployment(file)  # with the launch's settings it could name anything


def client_at(endpoint: str, running: Running | None = None) -> LaunchClient:
    """A client of the launch at an endpoint, of one known here on its keys alone; `TransportError` if none answers."""
    from hierax.runtime.transport import launch_client

    running = running or known_run(endpoint)
    keys = None if running is None else Keys(running.hierarchy, running.run)
    return launch_client.LaunchClient(endpoint, keys=keys)


def client_of(run: str | None, connect: str | None) -> LaunchClient:
    """A client of the launch that is meant. Raises as `endpoint_of` and `client_at` do."""
    return client_at(endpoint_of(run, connect))


def _clients() -> Iterator[tuple[LaunchClient, LaunchStatus]]:
    """Give, for completion, the launches on this machine that answer."""
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
