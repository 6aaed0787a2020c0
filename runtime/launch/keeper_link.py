"""The link to the keeper of another host: the system's `ssh`, from its start to what the keeper says first.

Which keys, settings and agent `ssh` uses is its user's matter. It is never let ask a question, as nobody would see it.
What the keeper is told goes through its standard input: nothing of a run is in an argument, or in the environment.
"""

import os
import re
import select
import shlex
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import IO, Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import Host
from hierax.runtime.host.installed import installed_digest, installed_version
from hierax.runtime.host.streams import python_module
from hierax.runtime.launch.frames import Frames
from hierax.runtime.launch.pipes import READ_BYTES
from hierax.schemas.errors import SchemaError

KEEPER = "hierax.runtime.launch.keeper"
MARK = b"\n-- the keeper of hierax --\n"
"""What the keeper says before its first frame: what comes before is said by the user's shell."""

GREETING_S = 30.0  # how long it may take until the keeper answers
CONNECT_S = 10  # how long `ssh` may take to connect, where its user has not said otherwise
END_S = 1.5  # how long it may take to end when it is told nothing more
MAX_NOISE_BYTES = 1 << 18  # what a user's shell may say before the keeper does

_NOT_INSTALLED = re.compile(r"No module named '?hierax(?![.\w])")
UNREACHED = 255  # exit code of `ssh`
_NOT_FOUND = (126, 127)  # of a shell


class HostError(HieraxError):
    """A host on which nodes are to run cannot be used; says which, why, and what was expected."""

    def __init__(self, host: Host, what: str) -> None:
        self.where = f"hosts.{host.name}"  # path in the deployment file
        super().__init__(f"{self.where}: {what}")


@dataclass(frozen=True)
class Greeting:
    """What a keeper says first."""

    version: str  # of hierax there
    digest: str  # of its files
    own_address: str  # of its host, as `ssh` has reached it; empty: it does not know
    our_address: str  # of this machine, likewise

    @staticmethod
    def read(value: Any, host: Host) -> "Greeting":
        value = value.get("here") if isinstance(value, dict) else None
        names = ("version", "digest", "own_address", "our_address")
        if not isinstance(value, dict) or not all(isinstance(value.get(name), str) for name in names):
            raise HostError(host, f"hierax there is another version; {_expected()}")
        return Greeting(*(value[name] for name in names))


class KeeperLink:
    """`ssh`, with a keeper at its other end. Raises `HostError` if there is no `ssh` here."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.frames = Frames()  # takes apart what the keeper says
        self._said = b""  # on standard error
        try:
            self.process = subprocess.Popen(
                ssh_command(host),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,  # Ctrl-C is for the launch
            )
        except OSError as error:
            raise HostError(host, f"`ssh` cannot be started here: {error.strerror or error}") from error
        self.orders, self.words, self.errors = map(_unblocked, self._streams)

    @property
    def _streams(self) -> list[IO[bytes]]:
        streams = self.process.stdin, self.process.stdout, self.process.stderr
        return [stream for stream in streams if stream is not None]

    def greeting(self) -> Greeting:
        """What the keeper says first; `HostError` if none comes, or one of another hierax than here."""
        greeting = Greeting.read(self._first_word(), self.host)
        if greeting.digest != installed_digest():
            there = f"version {greeting.version}, files {greeting.digest}"
            raise HostError(self.host, f"hierax there is another one: {there}; {_expected()}")
        return greeting

    def _first_word(self) -> Any:
        patience_s = time.monotonic() + GREETING_S
        noise, marked = b"", False
        while time.monotonic() < patience_s:
            ready, _, _ = select.select([self.words, self.errors], [], [], max(patience_s - time.monotonic(), 0.0))
            if self.errors in ready:
                self.heard(self._read(self.errors))
            if self.words not in ready:
                continue
            data = self._read(self.words)
            if not data:
                raise self._ended()
            if not marked:
                noise += data
                before, mark, data = noise.partition(MARK)
                marked = bool(mark)
                if not marked and len(before) > MAX_NOISE_BYTES:
                    raise HostError(
                        self.host, f"it says {noise[:40]!r}…; expected {self.host.python} to run the keeper"
                    )
            if marked:
                try:
                    values = self.frames.feed(data)
                except SchemaError as error:
                    raise HostError(self.host, f"hierax there is another version ({error}); {_expected()}") from error
                if values:
                    return values[0]
        raise HostError(self.host, f"no answer within {GREETING_S:g} s; expected its keeper to come up{self._last()}")

    def _ended(self) -> HostError:
        """Why there is no keeper."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(END_S)
        self._drain()
        code, text = self.process.returncode, self._said.decode(errors="replace")
        python = self.host.python
        if code == UNREACHED:
            return unreached(self.host, self._last())
        if code in _NOT_FOUND:
            what = f"there is no Python {python!r}{self._last()}; expected the command there that has hierax"
        elif _NOT_INSTALLED.search(text):
            what = f"hierax is not installed for {python} there{self._last()}; {_expected()}"
        elif KEEPER in text or "No module named 'hierax." in text:
            what = f"hierax of {python} there is another version{self._last()}; {_expected()}"
        else:
            what = f"{python} there ended with exit code {code}{self._last()}; expected it to run the keeper"
        return HostError(self.host, what)

    def _last(self) -> str:
        """The last line on standard error."""
        lines = [line.strip() for line in self._said.decode(errors="replace").splitlines() if line.strip()]
        return f": {lines[-1]:.200}" if lines else ""

    def _drain(self) -> None:
        while data := self._read(self.errors):
            self.heard(data)

    def _read(self, descriptor: int) -> bytes:
        try:
            return os.read(descriptor, READ_BYTES)
        except OSError:
            return b""

    @property
    def last_line(self) -> str:
        """What `ssh` has said last, when it has ended."""
        self._drain()
        return self._last()

    def heard(self, data: bytes) -> None:
        """What was read from `errors`."""
        self._said = (self._said + data)[-READ_BYTES:]

    def hang_up(self) -> None:
        """Tell the keeper nothing more, so that it ends its processes, and itself."""
        with suppress(OSError):
            self._streams[0].close()

    def close(self, patience_s: float = END_S) -> None:
        """The same, and wait until `ssh` has ended, but not for long."""
        self.hang_up()
        # what the keeper still says has to be read, or it could not end
        until_s = time.monotonic() + patience_s
        while self.process.poll() is None and time.monotonic() < until_s:
            select.select([self.words, self.errors], [], [], 0.02)
            if not self._read(self.words) and not self._read(self.errors):
                time.sleep(0.01)
        if self.process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        for stream in self._streams[1:]:
            stream.close()


def ssh_command(host: Host) -> list[str]:
    """What starts the keeper of a host."""
    return [*ssh_to(host), _remote_command(host)]


def ssh_to(host: Host) -> list[str]:
    """What a command of a host's shell stands behind. What its user has said of `ssh` goes before what is ours."""
    *options, destination = host.ssh
    ours = ["-T", "-o", "BatchMode=yes", "-o", f"ConnectTimeout={CONNECT_S}"]
    return ["ssh", *options, *ours, "--", destination]


def unreached(host: Host, said: str) -> HostError:
    """That `ssh` has not come there; `said`: what it has said, after a colon, or nothing."""
    told = " ".join(host.ssh)
    return HostError(host, f"cannot be reached{said}; expected `ssh {told}` to log in without a question")


def _unblocked(stream: IO[bytes]) -> int:
    os.set_blocking(stream.fileno(), False)
    return stream.fileno()


def _remote_command(host: Host) -> str:
    """For the shell there, which knows where its user's home is."""
    _, *arguments = python_module(KEEPER)
    command = f"exec {shell_path(host.python)} {shlex.join(arguments)}"
    return f"cd {shell_path(host.folder)} && {command}" if host.folder else command


def shell_path(path: str) -> str:
    """A path as the shell there reads it: `~` is its user's home."""
    first, *rest = PurePosixPath(path).parts
    return "/".join(("~", *map(shlex.quote, rest))) if first == "~" else shlex.quote(path)


def _expected() -> str:
    return f"expected the one of this machine: version {installed_version()}, files {installed_digest()}"
