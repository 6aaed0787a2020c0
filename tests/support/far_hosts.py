"""Hosts for launches: network namespaces of this machine, each with an `sshd` of its own, and a wire between them."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import pytest

from support.live import TESTS, lasting, until

DESK, ROBOT, ARM = "desk", "robot", "arm"
DELAY_MS, LOSS = 2.0, 0.01

_PORT = 2222
_SSHD = "/usr/sbin/sshd"
_SSHD_CONFIG = """\
Port {port}
ListenAddress {address}
HostKey {folder}/host
PidFile {folder}/{name}.pid
AuthorizedKeysFile {folder}/user.pub
UsePAM no
StrictModes no
PermitRootLogin yes
PasswordAuthentication no
"""
_SSH_CONFIG = """\
Host {name}
  HostName {address}
  Port {port}
  User root
  IdentityFile {folder}/user
  IdentitiesOnly yes
  UserKnownHostsFile {folder}/known_hosts
  StrictHostKeyChecking accept-new
  LogLevel ERROR
"""


def skip_without_hosts() -> None:
    """Skip a test where no hosts can be made."""
    for program in ("ip", "ssh", "ssh-keygen"):
        if shutil.which(program) is None:
            pytest.skip(f"hosts need `{program}`, which is not there (iproute2, openssh-client)")
    if not Path(_SSHD).exists():
        pytest.skip("hosts need `sshd`, which is not there (openssh-server)")
    if os.getuid() != 0:
        pytest.skip("network namespaces need root")
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        pytest.skip("a wire needs /dev/net/tun, which is not there")
    tried = subprocess.run(["ip", "netns", "add", f"hx{os.getpid()}"], capture_output=True, text=True, check=False)
    subprocess.run(["ip", "netns", "del", f"hx{os.getpid()}"], capture_output=True, check=False)
    if tried.returncode:
        pytest.skip(f"no network namespace can be made here: {tried.stderr.strip()}")


class FarHosts:
    """A desk, from which is launched, and two hosts beside it, on a wire. `folder`: for keys and settings."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.addresses = {name: f"10.213.79.{number}" for number, name in enumerate((DESK, ROBOT, ARM), 1)}
        self.namespaces = {name: f"hx{os.getpid()}{name}" for name in self.addresses}
        self._servers: dict[str, subprocess.Popen[bytes]] = {}
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)  # `sshd` wants it
        for key in ("host", "user"):
            subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / key)], check=True)
        for namespace in self.namespaces.values():
            subprocess.run(["ip", "netns", "add", namespace], check=True)
        ends = [f"{self.namespaces[name]}={address}" for name, address in self.addresses.items()]
        self._wire = subprocess.Popen(
            [sys.executable, "-m", "support.wire", str(DELAY_MS), str(LOSS), *ends],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(TESTS)},
        )
        self._hears("up")
        self.ssh_config = folder / "ssh_config"
        where = {"port": _PORT, "folder": folder}
        texts = (_SSH_CONFIG.format(name=name, address=self.addresses[name], **where) for name in (ROBOT, ARM))
        self.ssh_config.write_text("\n".join(texts), encoding="utf-8")
        for name in (ROBOT, ARM):
            config = folder / f"{name}.sshd"
            config.write_text(_SSHD_CONFIG.format(name=name, address=self.addresses[name], **where), encoding="utf-8")
            self.power_on(name)

    def power_on(self, name: str, disk: Path | None = None) -> None:
        """Start a host's `sshd`, and have the wire reach it. `disk`: a folder that is its own there, and empty; all
        others are those of this machine."""
        folder, namespace = self.folder, self.namespaces[name]
        sshd = [_SSHD, "-D", "-f", folder / f"{name}.sshd", "-E", folder / f"{name}.log"]
        # `ip` gives it mounts of its own, too
        own = [] if disk is None else ["sh", "-c", 'mount -t tmpfs tmpfs "$0" && exec "$@"', disk]
        self._servers[name] = subprocess.Popen(["ip", "netns", "exec", namespace, *own, *sshd])
        self.heal(name)
        until(lambda: (folder / f"{name}.pid").exists(), f"sshd of {name}")

    def seen_there(self, name: str, path: Path) -> Path:
        """A path of a host's, as it is found on this machine."""
        return Path(f"/proc/{self._servers[name].pid}/root{path}")

    def power_off(self, name: str) -> None:
        """Nothing is heard of a host any more, and all that ran there is gone."""
        self.cut(name)
        for pid in self.pids(name):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._servers.pop(name).wait()
        (self.folder / f"{name}.pid").unlink(missing_ok=True)

    def restore(self) -> None:
        """Have all hosts run, and the wire reach them."""
        for name in (ROBOT, ARM):
            self.heal(name)
            if name not in self._servers:
                self.power_on(name)

    def pids(self, name: str) -> list[int]:
        """What runs on a host, `sshd` among it."""
        told = subprocess.run(
            ["ip", "netns", "pids", self.namespaces[name]], capture_output=True, text=True, check=True
        )
        return [int(pid) for pid in told.stdout.split()]

    def is_idle(self, name: str) -> bool:
        """Whether nothing but `sshd` runs on a host."""
        return self.pids(name) == [self._servers[name].pid]

    def cut(self, name: str) -> None:
        """Nothing passes from and to a host any more, and nobody is told."""
        self._tell("cut", name)

    def heal(self, name: str) -> None:
        """All passes again."""
        self._tell("heal", name)

    def cut_for(self, name: str, seconds: float, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Cut a host off for a while."""
        self.cut(name)
        try:
            with lasting(seconds):
                meanwhile()
        finally:
            self.heal(name)

    def hosts(self, *, python: str = sys.executable, folder: Path = TESTS, **more: str) -> str:
        """`hosts` of a deployment file; `more` by host, further fields."""
        lines = [f"  {DESK}: local"]
        for name in (ROBOT, ARM):
            ssh = f'"-F {self.ssh_config} {name}"'
            further = f", {more[name]}" if name in more else ""
            lines.append(f"  {name}: {{ssh: {ssh}, python: {python}, folder: {folder}{further}}}")
        return "\n".join(("hosts:", *lines, ""))

    def remove(self) -> None:
        """End and remove all of it."""
        for name in list(self._servers):
            self.power_off(name)
        assert self._wire.stdin is not None
        assert self._wire.stdout is not None
        self._wire.stdin.close()
        self._wire.wait()
        self._wire.stdout.close()
        for namespace in self.namespaces.values():
            subprocess.run(["ip", "netns", "del", namespace], capture_output=True, check=False)

    def _tell(self, word: str, name: str) -> None:
        assert self._wire.stdin is not None
        print(word, self.namespaces[name], file=self._wire.stdin, flush=True)
        self._hears(word)

    def _hears(self, word: str) -> None:
        assert self._wire.stdout is not None
        line = self._wire.stdout.readline().strip()
        assert line == word, f"the wire says {line!r}, not {word!r}"


def script(path: Path, lines: Sequence[str]) -> str:
    """The path of a shell script."""
    path.write_text("\n".join(("#!/bin/sh", *lines, "")), encoding="utf-8")
    path.chmod(0o755)
    return str(path)
