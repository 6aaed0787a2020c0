"""The hosts of a launch: which one starts the process of a node."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

import anyio
import anyio.abc

from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import Host
from hierax.runtime.launch.child import Child, Overhearing, start_process
from hierax.runtime.launch.far_host import LOOK_S, FarHost, Notify
from hierax.runtime.launch.fork_server import ForkServer
from hierax.runtime.launch.frames import NodeOrder
from hierax.runtime.launch.keeper_link import Greeting, HostError, KeeperLink


class Reached:
    """The hosts that a deployment needs, beside this machine: each has answered, and has the same hierax."""

    def __init__(self, links: dict[str, tuple[KeeperLink, Greeting]]) -> None:
        self.links = links

    @property
    def addresses(self) -> set[str]:
        """At which the hosts reach this machine, as their ends of `ssh` tell."""
        return {greeting.our_address for _, greeting in self.links.values()}

    def address(self, hosts: Collection[Host]) -> str:
        """The one at which they do. Raises `HostError` if that is not known."""
        named = {host.address for host in hosts if host.is_here and host.address}
        found = named or self.addresses
        address = next(iter(found))
        if len(found) > 1 or not address:
            host = next(iter(self.links.values()))[0].host
            seen = ", ".join(sorted(found)) if address else "no address that `ssh` tells"
            raise HostError(host, f"the hosts reach this machine at {seen}; expected one: give it by --host ADDRESS")
        return address


@contextmanager
def reached(deployment: Deployment) -> Iterator[Reached]:
    """Start the keepers of the hosts that nodes are placed on, or may move to. Raises `HostError`, for the first host
    in the file that cannot be used."""
    links: dict[str, KeeperLink] = {}
    try:
        for name in needed_hosts(deployment):
            links[name] = KeeperLink(deployment.hosts[name])
        yield Reached({name: (link, link.greeting()) for name, link in links.items()})
    finally:
        for link in links.values():
            link.hang_up()
        for link in links.values():
            link.close()


def needed_hosts(deployment: Deployment) -> list[str]:
    """The hosts beside this machine that nodes are placed on, or may move to."""
    needed = set(deployment.placed.values())
    while more := {deployment.hosts[name].fallback for name in needed} - needed - {""}:
        needed |= more
    return [name for name, host in deployment.hosts.items() if name in needed and not host.is_here]


class Hosts:
    """Starts processes of nodes on the hosts where they are placed, or on those that stand in for them."""

    def __init__(self, deployment: Deployment, found: Reached, forks: ForkServer) -> None:
        self._forks = forks  # has processes of this machine forked
        self._hosts = deployment.hosts
        self._placed = deployment.placed
        self._far = {name: FarHost(self._hosts[name], link, greeting) for name, (link, greeting) in found.links.items()}

    def serve(self, tasks: anyio.abc.TaskGroup, overhearing: Overhearing, notify: Notify) -> None:
        """Listen to all of them from now on."""
        self._notify = notify
        for far in self._far.values():
            far.there.set()
            tasks.start_soon(far.keep, overhearing, notify)

    def close(self) -> None:
        """Have all keepers end their processes, and themselves; not for long."""
        for far in self._far.values():
            far.close()

    async def start(self, orders: Sequence[NodeOrder], overhearing: Overhearing) -> list[Child]:
        """Start the process of some orders where their nodes are to run now."""
        host = self._now(orders[0].name)
        if host in self._far:
            return self._far[host].start(orders)
        children = await start_process(orders, overhearing, self._forks)
        for child in children:
            child.host = host
        return children

    async def ready(self, name: str) -> None:
        """Wait until there is a host for a node; which one is told where it is another than it is placed on."""
        while not self._is_there(self._now(name)):
            await anyio.sleep(LOOK_S)
        now, placed = self._now(name), self._placed.get(name, "")
        if now != placed:
            self._notify(f"{name}: its next process is on host {now}, as {placed} is lost (fallback)")

    def _now(self, name: str) -> str:
        """The host of a node: the first one that is there of that where it is placed and those that stand in."""
        placed = host = self._placed.get(name, "")
        seen = {""}
        while host not in seen:
            if self._is_there(host):
                return host
            seen.add(host)
            host = self._hosts[host].fallback
        return placed

    def _is_there(self, host: str) -> bool:
        return host not in self._far or self._far[host].is_there
