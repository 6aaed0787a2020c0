"""A node on another host, whose link is cut and healed; a host is a network namespace of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.live import Live, Program, lasting, until

ADDRESSES = ("10.213.77.1", "10.213.77.2")
CUT_S = 5.0


class Hosts:
    """Two network namespaces and the link between them."""

    def __init__(self) -> None:
        self.names = tuple(f"hx{os.getpid()}{side}" for side in "ab")
        self._links = tuple(f"hx{os.getpid() % 100000}{side}" for side in "ab")
        for name in self.names:
            ip("netns", "add", name)
        ip("link", "add", self._links[0], "type", "veth", "peer", "name", self._links[1])
        for name, link, address in zip(self.names, self._links, ADDRESSES, strict=True):
            ip("link", "set", link, "netns", name)
            ip("-n", name, "addr", "add", f"{address}/24", "dev", link)
            ip("-n", name, "link", "set", "lo", "up")
            ip("-n", name, "link", "set", link, "up")

    def cut(self) -> None:
        """Nothing passes any more, and neither end is told."""
        ip("-n", self.names[1], "link", "set", self._links[1], "down")

    def heal(self) -> None:
        """All passes again."""
        ip("-n", self.names[1], "link", "set", self._links[1], "up")

    def remove(self) -> None:
        """Remove both; the link goes with them."""
        for name in self.names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def ip(*arguments: str) -> None:
    """A command of iproute2."""
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr}"


@pytest.fixture(scope="module")
def hosts() -> Iterator[Hosts]:
    if shutil.which("ip") is None:
        pytest.skip("network namespaces need iproute2's `ip`, which is not there")
    if os.getuid() != 0:
        pytest.skip("network namespaces need root")
    tried = subprocess.run(["ip", "netns", "add", f"hx{os.getpid()}"], capture_output=True, text=True, check=False)
    subprocess.run(["ip", "netns", "del", f"hx{os.getpid()}"], capture_output=True, check=False)
    if tried.returncode:
        pytest.skip(f"no network namespace can be made here: {tried.stderr.strip()}")
    made: list[Hosts] = []
    try:
        made.append(Hosts())
        yield made[0]
    finally:
        for each in made:
            each.remove()


class Far:
    """A launch on one host, and a node of it on the other."""

    def __init__(self, hosts: Hosts, folder: Path, policy: str) -> None:
        self.hosts = hosts
        self.live = Live(folder, "--host", ADDRESSES[0], namespace=hosts.names[0], pace_s=0.01)
        said = self.live.launch.says("others join with --connect")
        endpoint = said.split("--connect ")[1].split()[0]
        key = Path(shutil.copy(said.split()[-1], folder / "brought.key"))
        self.path = self.live.snippet("top", "high", policy=policy)
        where = ("--connect", endpoint, "--key", str(key))
        options = (*where, "--here", "--host", ADDRESSES[1], "--deployment", str(self.live.file))
        self.keeper: Program = self.live.start("attach", self.path, *options, namespace=hosts.names[1])
        self.attached = int(self.keeper.says("attached top at epoch").split()[-1])
        self.live.goes_on()

    @property
    def schedule(self) -> str:
        """The attach, as ``--at`` has it."""
        return f"{self.attached}:attach:{self.path}"

    @property
    def lost(self) -> int:
        """The epoch in which the node was lost."""
        return int(self.live.launch.says("top: its process is lost in epoch").split()[-1])

    def cut(self, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Cut the link for a while, and heal it."""
        self.hosts.cut()
        try:
            with lasting(CUT_S):
                meanwhile()
        finally:
            self.hosts.heal()


@pytest.fixture
def far(hosts: Hosts, tmp_path: Path) -> Iterator[Callable[[str], Far]]:
    made: list[Far] = []

    def make(policy: str) -> Far:
        made.append(Far(hosts, tmp_path, policy))
        return made[-1]

    yield make
    for each in made:
        each.live.close()


def test_restart_waits_for_the_node_and_takes_it_back(far: Callable[[str], Far]) -> None:
    node = far(", on_loss: restart")

    def is_held() -> None:
        assert node.lost > node.attached
        assert node.live.run["epoch"] == node.lost - 1
        assert node.live.run["nodes"]["top"]["state"] == "cut off"

    node.cut(is_held)
    node.keeper.says("taken for lost in epoch")
    until(lambda: node.live.epoch > node.lost + 10)
    assert node.live.run["nodes"]["top"]["state"] == "elsewhere"
    node.live.is_repeated_by(node.schedule)
    assert node.keeper.ends() == 0
    assert "top: its process exits: top: the run is over\n" in "".join(node.keeper.err)


def test_detach_goes_on_without_the_node_and_refuses_it_later(far: Callable[[str], Far]) -> None:
    node = far(", on_loss: detach, rejoin_timeout: 1")
    node.cut(lambda: until(lambda: node.live.epoch > node.lost + 10))
    assert node.keeper.ends() == 0
    assert "top: its process exits: top: it is no part of the hierarchy\n" in "".join(node.keeper.err)
    node.live.goes_on()
    node.live.is_repeated_by(node.schedule, f"{node.lost}:detach:top")


def test_stop_ends_the_run_and_the_node_ends_when_it_hears_of_it(far: Callable[[str], Far]) -> None:
    node = far(", on_loss: stop, rejoin_timeout: 1")
    node.cut(lambda: node.live.launch.process.wait(CUT_S))
    assert node.live.launch.ends() == 1
    assert node.live.launch.err[-1] == "error: top: it did not come back in time (rejoin_timeout)\n"
    assert node.keeper.ends() == 1
    assert "is gone; its nodes here are ended\n" in node.keeper.err[-1]


def test_a_node_that_was_attached_anew_meanwhile_is_refused(far: Callable[[str], Far]) -> None:
    node = far(", on_loss: restart")
    anew = node.live.snippet("top", "low", 1)
    epochs: list[int] = []

    def attach_anew() -> None:
        assert node.lost
        epochs.extend((node.live.change("detach", "top"), node.live.change("attach", anew)))
        node.live.goes_on()

    node.cut(attach_anew)
    assert node.keeper.ends() == 0
    assert "top: its process exits: top: another process runs it\n" in "".join(node.keeper.err)
    node.live.goes_on()
    detached, attached = epochs
    node.live.is_repeated_by(node.schedule, f"{detached}:detach:top", f"{attached}:attach:{anew}")
