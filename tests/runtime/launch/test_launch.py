"""Launches: the same run as in one process, and processes that always end."""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from support.launched import processes_below, processes_of, run_here
from support.recompute_digest import main as recompute_digest
from support.sweep import examples

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.launch import supervisor
from hierax.runtime.launch.roster_supervisor import RosterSupervisor

HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]
TESTS = Path(__file__).parents[2]
TIMEOUT_S = 60.0
ENDED_S = 30.0
"""Less than any deadline; how quick it is, `make interrupts` shows."""


def hierax(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*HIERAX, *arguments], capture_output=True, text=True, timeout=TIMEOUT_S, env=environment(), check=False
    )


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(TESTS)}


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until(condition: Callable[[], bool], timeout_s: float = TIMEOUT_S) -> float:
    """Seconds until a condition holds."""
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < timeout_s, "it did not come to that"
        time.sleep(0.005)
    return time.monotonic() - begun


def orphans() -> set[Path]:
    """Shared-memory segments that nobody holds. Others' runs may leave some, for a moment: whoever ends removes all."""
    return {path for path in Path("/dev/shm").glob("*.zenoh") if is_free(path)}


def is_free(path: Path) -> bool:
    try:
        with path.open("rb+") as segment:
            fcntl.flock(segment, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, FileNotFoundError):
        return False
    return True


@pytest.mark.parametrize(
    ("deployment", "options"),
    [
        ("letters", ["--epochs", "20"]),
        ("letters", ["--epochs", "3", "--set", "letters='T?E'"]),
        ("letters-image", ["--epochs", "5"]),
        ("servo", ["--set", "context=true"]),
        ("servo", ["--set", "context=false"]),
        ("letters", ["--epochs", "20", "--set", "low_latency=true"]),
        ("chain", ["--epochs", "50", "--set", "picture=100000"]),
    ],
)
@pytest.mark.parametrize("seed", ["7", "0"][: examples(1, 2)])
def test_launch_is_run(deployment: str, options: list[str], seed: str, tmp_path: Path) -> None:
    """Equal digests and states, which an independent script takes again."""
    reports = {}
    for mode in ("run", "launch"):
        output = str(tmp_path / mode)
        done = hierax(mode, deployment, "--seed", seed, "--format", "json", "--output", output, *options)
        assert done.returncode == 0, done.stderr
        assert recompute_digest([output]) == 0
        reports[mode] = json.loads(done.stdout)
    assert reports["launch"]["digest"] == reports["run"]["digest"]
    assert reports["launch"]["nodes"] == reports["run"]["nodes"]
    until(lambda: not orphans())


def test_a_message_that_is_too_long_for_low_latency_links_ends_it_with_one_line() -> None:
    done = hierax("launch", "chain", "--epochs", "9", "--set", "picture=100000", "--set", "low_latency=true")
    assert done.returncode == 1
    said = [line for line in done.stderr.splitlines() if "error" in line]
    assert len(said) == 1, done.stderr
    assert "spatial: a ctx message of 1" in said[0]
    assert said[0].endswith("for arm; low-latency links carry at most 32768")
    until(lambda: not orphans())


def test_seeds_make_a_difference() -> None:
    assert len({run_here("servo", "--seed", seed)["digest"] for seed in "012"}) == 3


TWO_NODES = """
hierarchy: two
world: clock
nodes:
  clock: {{class: "support.slow_nodes:Clock"}}
  node: {node}
edges:
  clock -> node: {{sense: "support.slow_nodes:number"}}
"""


@pytest.fixture
def two(tmp_path: Path) -> Callable[[str], str]:
    def write(node: str) -> str:
        path = tmp_path / "two.yaml"
        path.write_text(TWO_NODES.format(node=node))
        return str(path)

    return write


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_an_operator_may_wait_for_the_outside(two: Callable[[str], str], mode: str) -> None:
    done = hierax(mode, two('{class: "support.slow_nodes:Waiting"}'), "--epochs", "4", "--format", "json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["nodes"]["node"]["belief"] == 0 + 1 + 2 + 3


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_a_failing_operator_ends_it_with_one_line(two: Callable[[str], str], mode: str) -> None:
    done = hierax(mode, two('{class: "support.slow_nodes:Failing", parameters: {epoch: 3}}'), "--epochs", "9")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: node: predict in epoch 3: RuntimeError: out of luck (")
    assert re.search(r"slow_nodes\.py:\d+, in predict\)$", line)


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_a_node_that_cannot_be_built_is_named_with_its_line(two: Callable[[str], str], mode: str) -> None:
    done = hierax(mode, two('{class: "support.slow_nodes:Failing", parameters: {epok: 3}}'), "--epochs", "9")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "two.yaml:6: nodes.node.parameters.epok" in done.stderr
    assert "did you mean 'epoch'?" in done.stderr


def test_a_program_that_a_node_leaves_running_ends_with_it(two: Callable[[str], str]) -> None:
    done = hierax("launch", two('{class: "support.slow_nodes:Starting"}'), "--epochs", "2")
    assert done.returncode == 0, done.stderr
    until(lambda: not is_alive(int(done.stderr.removeprefix("node: "))), ENDED_S)


@pytest.mark.parametrize(("dies", "code"), [("false", 0), ("true", 1)])
def test_a_fork_that_holds_the_pipes_holds_nothing_up(two: Callable[[str], str], dies: str, code: int) -> None:
    node = f'{{class: "support.slow_nodes:Forking", parameters: {{dies: {dies}}}}}'
    done = hierax("launch", two(node), "--epochs", "2")
    assert done.returncode == code, done.stderr
    if code:
        last = "error: node: its process ended by signal SIGKILL; it is not started again (max_restarts: 5 in 60 s)"
        assert done.stderr.splitlines()[-1] == last


def test_what_a_node_reads_from_standard_input_is_empty(two: Callable[[str], str]) -> None:
    done = hierax("launch", two('{class: "support.slow_nodes:Reading"}'), "--epochs", "2", "--format", "json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["nodes"]["node"]["belief"] == ""


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_a_world_alone_is_a_hierarchy(mode: str, tmp_path: Path) -> None:
    path = tmp_path / "one.yaml"
    path.write_text('hierarchy: one\nworld: clock\nnodes:\n  clock: {class: "support.slow_nodes:Clock"}\n')
    done = hierax(mode, str(path), "--epochs", "5", "--format", "json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["nodes"]["clock"]["belief"] == 5


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ("{scouting: {gossip: {enabled: false}}}", "error: not up within 2 s (start_timeout_s): clock, node"),
        ('{listen: {endpoints: ["tcp/127.0.0.1:1x"]}}', "error: Zenoh: "),
    ],
)
def test_settings_that_keep_nodes_apart_end_it_with_one_line(
    two: Callable[[str], str], settings: str, what: str
) -> None:
    path = two('{class: "support.slow_nodes:Waiting"}')
    with open(path, "a") as file:
        file.write(f"start_timeout_s: 2\nzenoh: {settings}\n")
    done = hierax("launch", path, "--epochs", "2")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith(what)


class Launched:
    """A launch under way, and its nodes' processes."""

    def __init__(self, path: str, settings: Sequence[str] = ()) -> None:
        self.process = subprocess.Popen(
            [*HIERAX, "launch", path, *settings],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(),
            start_new_session=True,
        )
        until(lambda: len(processes_of(self.process.pid)) == 2)
        self.nodes = processes_of(self.process.pid)

    def until_stuck(self) -> None:
        assert self.process.stderr is not None
        assert self.process.stderr.readline() == "node: stuck\n"

    def until_gone(self) -> float:
        return until(lambda: not any(map(is_alive, [self.process.pid, *self.nodes])))

    def end(self) -> tuple[str, str]:
        return self.process.communicate(timeout=TIMEOUT_S)


@pytest.fixture
def settings() -> Sequence[str]:
    return ()


@pytest.fixture
def launched(two: Callable[[str], str], settings: Sequence[str]) -> Iterator[Launched]:
    launch = Launched(two('{class: "support.slow_nodes:Stuck", parameters: {epoch: 50}}'), settings)
    yield launch
    for pid in (launch.process.pid, *launch.nodes):
        if is_alive(pid):
            os.kill(pid, signal.SIGKILL)
    launch.process.communicate(timeout=TIMEOUT_S)


def test_every_node_has_a_process_of_its_own(launched: Launched) -> None:
    assert len({launched.process.pid, os.getpid(), *launched.nodes}) == 4


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_all(launched: Launched, number: signal.Signals) -> None:
    launched.until_stuck()
    launched.process.send_signal(number)
    assert launched.until_gone() < ENDED_S
    out, err = launched.end()
    assert launched.process.returncode == 130
    assert "launch, seed 0, 49 epochs in" in out
    assert "Traceback" not in err
    assert err.splitlines()[-1] == "interrupted"
    until(lambda: not orphans())


def test_a_signal_while_starting_ends_all(two: Callable[[str], str]) -> None:
    launch = Launched(two('{class: "support.slow_nodes:Stuck", parameters: {epoch: 1}}'))
    launch.process.send_signal(signal.SIGINT)
    assert launch.until_gone() < ENDED_S
    _, err = launch.end()
    assert launch.process.returncode == 130
    assert "Traceback" not in err


def test_nodes_and_recorders_are_deaf_to_ctrl_c_from_their_first_instant(tmp_path: Path) -> None:
    command = [*HIERAX, "launch", "letters", "--epochs", "30", "--record", str(tmp_path / "a.mcap")]
    launch = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    pressed: set[int] = set()
    while launch.poll() is None:
        children = processes_below(launch.pid)
        for pid in [*children, *(forked for child in children for forked in processes_below(child))]:
            pressed.add(pid)
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGINT)
        time.sleep(0.001)
    _, err = launch.communicate(timeout=TIMEOUT_S)
    assert launch.returncode == 0, err
    assert not err
    assert len(pressed) >= 7, "the recorder, what nodes are forked from, and they"


def test_a_second_signal_kills(launched: Launched) -> None:
    launched.until_stuck()
    launched.process.send_signal(signal.SIGINT)
    until(lambda: launched.process.poll() is not None or any(map(is_alive, launched.nodes)))
    launched.process.send_signal(signal.SIGINT)
    assert launched.until_gone() < ENDED_S
    launched.end()
    assert launched.process.returncode == 130


@pytest.mark.parametrize("settings", [("--set", "restart.restart_policy=never")])
def test_a_node_that_dies_is_named(launched: Launched) -> None:
    launched.until_stuck()
    os.kill(launched.nodes[1], signal.SIGKILL)
    assert launched.until_gone() < ENDED_S
    _, err = launched.end()
    assert launched.process.returncode == 1
    assert err.splitlines()[-1] == (
        "error: node: its process ended by signal SIGKILL; it is not started again (restart_policy: never)"
    )


def test_nodes_do_not_outlive_their_supervisor(launched: Launched) -> None:
    launched.until_stuck()
    launched.process.kill()
    assert launched.until_gone() < ENDED_S


def test_what_fails_beside_a_run_is_told_as_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    async def fail(processes: RosterSupervisor) -> None:
        raise HieraxError("the disk is full")

    monkeypatch.setattr(RosterSupervisor, "watch_world", fail)
    with pytest.raises(HieraxError, match=r"^the disk is full$"):
        supervisor.launch(read_deployment("letters"), epochs=None, seed=0)
