"""Which launch a command means, and how it is asked."""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from hierax.runtime.commands.errors import CommandError, notify
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_folder import meant
from hierax.runtime.host.run_secret import read_key
from hierax.runtime.launch.run_file import Running, known_runs, warning_of
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.keys import Keys

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus

_ENDPOINT = re.compile(r"[a-z]+/.+:[0-9]+")


def runs_here() -> list[tuple[str, str]]:
    """Give, for completion, the launches that run on this machine, and what they run."""
    return [(each.run, each.hierarchy) for each in known_runs()]


@dataclass(frozen=True)
class Meant:
    """A launch that is meant."""

    endpoint: str  # where it is reached
    secret: str = field(default="", repr=False)  # of its run; empty: it is open, or nobody has said
    running: Running | None = None  # what is known of it, where it runs on this machine and is this user's

    @staticmethod
    def here(running: Running) -> "Meant":
        """One of this user's on this machine. Raises `HieraxError` if its key cannot be read."""
        return Meant(running.endpoint, running.secret, running)


def launch_meant(run: str | None, connect: str | None, key: Path | None = None) -> "Meant":
    """The launch that is meant. Raises `CommandError` if there is none, or several may be meant, and `HieraxError` if
    its key cannot be read."""
    if connect is not None:
        if not _ENDPOINT.fullmatch(connect):
            raise CommandError(f"--connect: expected an endpoint such as tls/192.168.1.2:40123, got {connect!r}")
        running = next((each for each in known_runs() if each.endpoint == connect), None)
        if key is None:
            return Meant(connect) if running is None else Meant.here(running)
        return Meant(connect, read_key(key), running)
    if key is not None:
        raise CommandError("--key: only with --connect; of a launch on this machine it is found")
    runs = known_runs()
    found = runs if run is None else meant(run, runs, lambda each: (each.run, each.hierarchy))
    if len(found) > 1:
        which = "" if run is None else f" of {run!r}"
        listed = ", ".join(f"{each.run} ({each.hierarchy})" for each in found)
        raise CommandError(f"several launches{which} run on this machine, say which with --run: {listed}")
    if found:
        return Meant.here(found[0])
    if run is None:
        raise CommandError("no launch runs on this machine")
    near = did_you_mean(run, [name for each in runs for name in (each.run, each.hierarchy)], "there are")
    raise CommandError(f"no launch {run!r} runs on this machine{near}")


def own_deployment(launch: Meant, file: str | None) -> "Deployment | None":
    """The deployment of a launch as its user on this machine knows it; None: no more is known than the launch says."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.deployment.secrets import usable

    if launch.running is not None:
        return read_deployment(file or launch.running.deployment, usable(launch.running.settings))
    return None if file is None else read_deployment(file)  # with the launch's settings it could name anything


def client_at(launch: Meant) -> "LaunchClient":
    """A client of a launch, of one known here on its keys alone; `TransportError` if none answers."""
    client = _client(launch)
    warning = warning_of(launch.endpoint, launch.secret)  # that was needed, as it has let us in
    if warning:
        _warn(warning)
    return client


@cache
def _warn(what: str) -> None:
    """Tell it once, in whatever way a command speaks to its launch."""
    notify(what)


def _client(launch: Meant) -> "LaunchClient":
    from hierax.runtime.transport import launch_client

    running = launch.running
    keys = None if running is None else Keys(running.hierarchy, running.run)
    return launch_client.LaunchClient(launch.endpoint, keys=keys, secret=launch.secret)


def _clients() -> "Iterator[tuple[LaunchClient, LaunchStatus]]":
    """Give, for completion, the launches on this machine that answer."""
    for running in known_runs():
        with suppress(HieraxError), _client(Meant.here(running)) as client:  # it may have ended just now
            yield client, client.status()


def nodes_here() -> list[str]:
    """Give, for completion, the nodes of the launches on this machine."""
    return sorted({name for _, status in _clients() for name in status.nodes})


def keys_here() -> list[str]:
    """Give, for completion, the keys of the launches on this machine."""
    from hierax.runtime.tools.echoes import edges_of, short_key

    return sorted({short_key(edge) for client, status in _clients() for edge in edges_of(client.edges(status))})
