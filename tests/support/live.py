"""Launches that run beside a test: started, asked, changed, ended, repeated in one process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hierax.runtime.host.run_secret import read_key
from hierax.runtime.transport.launch_client import LaunchClient
from support.launched import run_here, said_here
from support.live_nodes import PACE_S

HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]
TESTS = Path(__file__).parents[1]
TIMEOUT_S = 60.0
MIXING = "hierax.runtime.sim.nodes"

DEPLOYMENT = """\
hierarchy: live
world: world
modules: ["hierax.runtime.sim.*", "support.*"]
start_timeout_s: 60
restart: {{rejoin_timeout: 1}}
nodes:
  world: {{class: "support.live_nodes:Gated", parameters: {{stop: "{stop}"}}}}
  low: {{class: "hierax.runtime.sim.nodes:Drawer", parameters: {{name: low}}}}
  high: {{class: "hierax.runtime.sim.nodes:Mixer", parameters: {{name: high, policies: 2}}}}
edges:
  world -> low:
    sense: {{function: "hierax.runtime.sim.nodes:DrawingMix", parameters: {{name: w-l-s}}}}
    task: {{function: "hierax.runtime.sim.nodes:Mix", parameters: {{name: w-l-t}}}}
    context: {{function: "hierax.runtime.sim.nodes:Mix", parameters: {{name: w-l-c}}}}
  low -> high:
    sense: {{function: "hierax.runtime.sim.nodes:Mix", parameters: {{name: l-h-s}}}}
    task: {{function: "hierax.runtime.sim.nodes:Mix", parameters: {{name: l-h-t}}}}
    context: {{function: "hierax.runtime.sim.nodes:DrawingMix", parameters: {{name: l-h-c}}}}
"""
"""world -> low -> high."""

NODE = """\
nodes:
  {name}: {{class: "hierax.runtime.sim.nodes:Mixer", parameters: {{name: {name}, generation: {generation}}}{policy}}}
"""
EDGE = """\
edges:
  {lower} -> {name}:
    sense: {{function: "hierax.runtime.sim.nodes:Mix", parameters: {{name: {lower}-{name}-s}}}}
    context: {{function: "hierax.runtime.sim.nodes:Mix", parameters: {{name: {lower}-{name}-c}}}}
"""


def until(condition: Callable[[], Any], what: str = "it", timeout_s: float = TIMEOUT_S) -> Any:
    """What a condition gives once that is true."""
    patience = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < patience, f"{what} did not come to pass"
        time.sleep(0.01)
    return found


@contextmanager
def lasting(seconds: float) -> Iterator[None]:
    """A block that takes at least so long."""
    timer = threading.Timer(seconds, lambda: None)
    timer.start()
    yield
    timer.join()


class Program:
    """``hierax`` with some arguments, in a process of its own; its lines are read as they come."""

    def __init__(self, arguments: Sequence[str], environment: dict[str, str], namespace: str = "") -> None:
        prefix = ["ip", "netns", "exec", namespace] if namespace else []
        self.process = subprocess.Popen(
            [*prefix, *HIERAX, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=lines.extend, args=(stream,), daemon=True)
            for lines, stream in ((self.out, self.process.stdout), (self.err, self.process.stderr))
        ]
        for reader in self._readers:
            reader.start()

    def says(self, part: str) -> str:
        """The first line with a text, once it is there."""
        return str(until(lambda: next((line for line in (*self.out, *self.err) if part in line), ""), f"{part!r}"))

    def ends(self) -> int:
        """The exit code, once there is one."""
        code = self.process.wait(TIMEOUT_S)
        for reader in self._readers:
            reader.join(TIMEOUT_S)
        return code

    def kill(self) -> None:
        """End it, and give up its pipes."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.ends()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()


class Live:
    """A launch under way.

    Args:
        folder: for its files; other launches are not seen from within.
        namespace: network namespace that it runs in; empty: this one.
        more: further lines of the deployment file.
        pace_s: what the world waits in each epoch; the less, the more of the processor goes into epochs.
        settings: of the deployment file, as ``--set`` has them.
        options: of ``hierax launch``.
    """

    def __init__(
        self,
        folder: Path,
        *options: str,
        namespace: str = "",
        pace_s: float = 0.003,
        more: str = "",
        settings: Sequence[str] = (),
    ) -> None:
        self.folder = folder
        self._settings = [argument for setting in settings for argument in ("--set", setting)]
        self.namespace = namespace
        self.file = folder / "live.yaml"
        self._stop = folder / "stop"
        self.is_attacked = False  # whether somebody tries what its certificate does not let it
        self.file.write_text(DEPLOYMENT.format(stop=self._stop) + more, encoding="utf-8")
        self._programs: list[Program] = []
        self._client: LaunchClient | None = None
        self._asking: subprocess.Popen[str] | None = None
        self._pace_s = pace_s
        self.launch = self.start(
            "launch", str(self.file), "--format", "json", *self._settings, *options, namespace=namespace
        )
        until(lambda: list((folder / "hierax").glob("*.json")), "the launch")
        until(lambda: self.epoch > 0, "the first epoch")

    def start(self, *arguments: str, namespace: str = "") -> Program:
        """Start a command."""
        program = Program(arguments, {**environment(self.folder), PACE_S: str(self._pace_s)}, namespace)
        self._programs.append(program)
        return program

    def snippet(self, name: str, lower: str = "", generation: int = 0, policy: str = "") -> str:
        """The path of a snippet with a node, and with an edge from below where that is given."""
        path = self.folder / f"{name}-{generation}.yaml"
        text = NODE.format(name=name, generation=generation, policy=policy)
        path.write_text(text + (EDGE.format(lower=lower, name=name) if lower else ""), encoding="utf-8")
        return str(path)

    def hierax(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """What a command says, in the launch's namespace."""
        if not self.namespace and threading.current_thread() is threading.main_thread():
            return said_here(*arguments, folder=self.folder)  # a process's start takes longer than what is asked for
        try:
            return hierax(self.folder, *arguments, namespace=self.namespace)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"{error}; the launch has said\n{''.join(self.launch.err)}") from error

    def change(self, *arguments: str) -> int:
        """The first epoch under a change."""
        done = self.hierax(*arguments, "--format", "json")
        assert done.returncode == 0, (arguments, done.stderr, self.launch.err)
        epoch: int = json.loads(done.stdout)["epoch"]
        return epoch

    @property
    def epoch(self) -> int:
        """The last one committed, or some before it."""
        return int(self.run["epoch"])

    @property
    def run(self) -> dict[str, Any]:
        """What ``hierax ps`` tells of it."""
        if not self.namespace:
            self._client = self._client or LaunchClient(self.endpoint, secret=self.secret)
            return self._client.ask({"ask": "ps"})
        return self._asked_from_within()

    @property
    def endpoint(self) -> str:
        """Where it is reached."""
        (file,) = (self.folder / "hierax").glob("*.json")
        return str(json.loads(file.read_text(encoding="utf-8"))["endpoint"])

    @property
    def key(self) -> Path:
        """The file that lets others in."""
        (file,) = (self.folder / "hierax").glob("*.key")
        return file

    def brought_key(self, folder: Path) -> Path:
        """A copy of that, in a folder of its own, as it is brought to another machine."""
        folder.mkdir()
        return Path(shutil.copy(self.key, folder / "brought.key"))

    @property
    def secret(self) -> str:
        """What is in there; empty: the launch is open."""
        return read_key(self.key) if list((self.folder / "hierax").glob("*.key")) else ""

    def goes_on(self) -> None:
        """Wait until some more epochs are committed."""
        before = self.epoch
        until(lambda: self.epoch > before + 10, "further epochs")

    def ends(self) -> dict[str, Any]:
        """The report, after the end of the run."""
        self._stop.touch()
        assert self.launch.ends() == 0, self.launch.err
        self._stop.unlink()
        report: dict[str, Any] = json.loads("".join(self.launch.out))
        return report

    def repeated(self, epochs: int, *schedule: str) -> dict[str, Any]:
        """The report of ``hierax run`` with changes as ``--at`` has them."""
        at = [argument for change in schedule for argument in ("--at", change)]
        return run_here(str(self.file), "--epochs", str(epochs), *self._settings, *at)

    def is_repeated_by(self, *schedule: str) -> None:
        """End it, and compare it with one process under the same changes."""
        report = self.ends()
        strange = [line for line in self.launch.err if not line.startswith("hierax: ")]
        assert not strange, strange
        refused = [line for line in self.launch.err if "refused the certificate of" in line]
        assert self.is_attacked or not refused, refused
        wanted = self.repeated(report["epochs"], *schedule)
        assert report["digest"] == wanted["digest"], (schedule, self.launch.err)
        assert report["nodes"] == {name: wanted["nodes"][name] for name in report["nodes"]}

    def close(self) -> None:
        """End what is left."""
        if self._client is not None:
            self._client.close()
        if self._asking is not None:
            self._asking.communicate(timeout=TIMEOUT_S)
        for program in reversed(self._programs):
            program.kill()

    def _asked_from_within(self) -> dict[str, Any]:
        """What the launch answers to somebody in its namespace."""
        if self._asking is None:
            self._asking = subprocess.Popen(
                [
                    "ip",
                    "netns",
                    "exec",
                    self.namespace,
                    sys.executable,
                    "-m",
                    "support.asking",
                    self.endpoint,
                    self.key,
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=environment(self.folder),
            )
        assert self._asking.stdin is not None
        assert self._asking.stdout is not None
        print(file=self._asking.stdin, flush=True)
        return dict(json.loads(self._asking.stdout.readline()))


def renewed(live: Live) -> Counter[str]:
    """How often processes of a launch have got another certificate, by the nodes that said so."""
    lines = live.hierax("logs").stdout.splitlines()
    return Counter(line.rpartition(f": {_RENEWED}")[0].rpartition(" ")[2] for line in lines if line.endswith(_RENEWED))


_RENEWED = "its process shows another certificate from now on"


def environment(folder: Path) -> dict[str, str]:
    """For commands that see the runs of a folder alone."""
    return {**os.environ, "PYTHONPATH": str(TESTS), "XDG_RUNTIME_DIR": str(folder)}


def hierax(folder: Path, *arguments: str, namespace: str = "") -> subprocess.CompletedProcess[str]:
    """What a command says."""
    prefix = ["ip", "netns", "exec", namespace] if namespace else []
    return subprocess.run(
        [*prefix, *HIERAX, *arguments],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        env=environment(folder),
        check=False,
    )
