"""Nodes on hosts that a deployment file names, reached by `ssh`; hosts are network namespaces of this machine."""

from __future__ import annotations

import json
import re
import shutil
import signal
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.far_hosts import ARM, DESK, ROBOT, FarHosts, script, skip_without_hosts
from support.live import DEPLOYMENT, Live, hierax, renewed, until

CUT_S = 5.0
ENDS_S = 10.0  # Ctrl-C takes less than 2 s (benchmarks/hosts.py); here, others may have the processors
FAKETIME = Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1")


@pytest.fixture(scope="module")
def far(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FarHosts]:
    skip_without_hosts()
    made = FarHosts(tmp_path_factory.mktemp("far"))
    try:
        yield made
    finally:
        made.remove()


Launch = Callable[..., Live]


@pytest.fixture
def launch(far: FarHosts, tmp_path: Path) -> Iterator[Launch]:
    """Launches on the desk, by what its deployment file says of hosts and places; with options."""
    made: list[Live] = []

    def begin(more: str, *options: str, **given: Any) -> Live:
        made.append(Live(tmp_path, *options, namespace=far.namespaces[DESK], pace_s=0.01, more=more, **given))
        return made[-1]

    yield begin
    for each in made:
        each.close()
    far.restore()


OWN = "nodes.low.class=own_drawer:Own"


def with_own_module(far: FarHosts, folder: Path) -> str:
    """What a file says of hosts with a module of its own beside it, where the robot has an empty folder."""
    (folder / "own_drawer.py").write_text("from hierax.runtime.sim.nodes import Drawer as Own\n", encoding="utf-8")
    far.power_off(ROBOT)
    far.power_on(ROBOT, disk=folder)
    hosts = re.sub(", folder: [^,}]*", "", far.hosts())
    return f"{hosts}place: {{low: robot}}\n"


def states(live: Live) -> dict[str, tuple[str, str, int]]:
    """Of each node what state it is in, on which host, and its restarts."""
    return {name: (node["state"], node["host"], node["restarts"]) for name, node in live.run["nodes"].items()}


def said_otherwise(live: Live, *expected: str) -> list[str]:
    """What a launch has told people beside where it is reached, and some beginnings of lines."""
    known = ("others join with", *expected)
    return [line for line in live.launch.err if not line.removeprefix("hierax: ").startswith(known)]


def is_repeated(live: Live, *schedule: str) -> None:
    """End it, and compare its digest with that of one process."""
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"], *schedule)["digest"], live.launch.err


def test_nodes_run_where_they_are_placed_with_the_digests_of_one_process(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts() + "place: {world: robot, low: arm, high: desk}\n")
    live.goes_on()
    assert states(live) == {
        "world": ("running", ROBOT, 0),
        "low": ("running", ARM, 0),
        "high": ("running", DESK, 0),
    }
    assert not far.is_idle(ROBOT)
    assert not far.is_idle(ARM)
    is_repeated(live)
    until(lambda: far.is_idle(ROBOT) and far.is_idle(ARM), "the end of the keepers")
    assert said_otherwise(live) == []


def test_states_digests_and_logs_are_those_of_one_process(far: FarHosts, launch: Launch, tmp_path: Path) -> None:
    live = launch(far.hosts() + "place: {world: robot, low: arm}\n", "--output", str(tmp_path / "out"))
    report = live.ends()
    again = hierax(
        tmp_path, "run", str(live.file), "--epochs", str(report["epochs"]), "--output", str(tmp_path / "again")
    )
    assert again.returncode == 0, again.stderr
    for name in ("digests", "states/world", "states/low", "states/high"):
        file = f"{name}.msgpack"
        assert (tmp_path / "out" / file).read_bytes() == (tmp_path / "again" / file).read_bytes(), name
    logs = hierax(tmp_path, "logs", "--run", report["hierarchy"], "--node", "low", "--format", "json")
    assert "of low: begin" in logs.stdout, (logs.stdout, logs.stderr)


def test_nodes_that_share_a_process_are_lost_and_move_together(far: FarHosts, launch: Launch) -> None:
    more = far.hosts(robot="fallback: arm, lost_after: 2") + "place: {world: robot, low: robot}\n"
    live = launch(more + "processes: {both: [world, low]}\n")
    live.goes_on()
    nodes = live.run["nodes"]
    assert nodes["world"]["pid"] == nodes["low"]["pid"]
    assert (nodes["world"]["host"], nodes["low"]["host"]) == (ROBOT, ROBOT)
    far.power_off(ROBOT)
    live.launch.says("both (low, world): its process ended with host robot; it is started again")
    live.goes_on()
    assert {states(live)[name][1] for name in ("world", "low")} == {ARM}
    is_repeated(live)


def test_ctrl_c_ends_the_processes_on_all_hosts(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts() + "place: {world: robot, low: arm}\n")
    live.goes_on()
    live.launch.process.send_signal(signal.SIGINT)
    signalled_s = time.monotonic()
    assert live.launch.ends() == 130
    until(lambda: far.is_idle(ROBOT) and far.is_idle(ARM), "the end of the keepers", ENDS_S)
    took_s = time.monotonic() - signalled_s
    assert took_s < ENDS_S, f"all processes were gone {took_s:.1f} s after Ctrl-C"
    report = json.loads("".join(live.launch.out))
    assert report["digest"] == live.repeated(report["epochs"])["digest"]


def test_a_keeper_ends_its_processes_when_its_launch_is_killed(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts() + "place: {world: robot, low: arm}\n")
    live.goes_on()
    live.launch.process.kill()
    until(lambda: far.is_idle(ROBOT) and far.is_idle(ARM), "the end of the keepers")


def test_a_link_that_is_cut_and_healed_holds_the_epoch_and_nothing_else(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts(robot="lost_after: 30") + "place: {low: robot, high: arm}\n")
    live.goes_on()
    far.cut_for(ROBOT, CUT_S, lambda: until(lambda: live.run["nodes"]["low"]["state"] == "cut off", "the cut"))
    live.goes_on()
    assert states(live)["low"] == ("running", ROBOT, 0)
    is_repeated(live)
    assert said_otherwise(live) == []


def test_the_nodes_of_a_lost_host_move_with_what_they_knew(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts(robot="fallback: desk, lost_after: 2") + "place: {world: robot, low: robot, high: arm}\n")
    live.goes_on()
    far.power_off(ROBOT)
    live.launch.says("host robot is lost: nothing was heard of it for 2 s (lost_after)")
    live.goes_on()
    now = {name: where for name, (*where, _) in states(live).items()}
    expected = {"world": ["running", DESK], "low": ["running", DESK], "high": ["running", ARM]}
    assert now == expected, live.launch.err
    far.power_on(ROBOT)
    live.launch.says("host robot is there again")
    is_repeated(live)


def test_nodes_wait_for_a_lost_host_until_it_is_there_again(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts(robot="lost_after: 2") + "place: {low: robot}\n")
    live.goes_on()
    far.power_off(ROBOT)
    live.launch.says("low: its process ended with host robot; it is started again")
    held = live.epoch
    until(lambda: states(live)["low"][0] == "restarting")
    far.power_on(ROBOT)
    live.launch.says("host robot is there again")
    live.goes_on()
    assert live.epoch > held
    assert states(live)["low"] == ("running", ROBOT, 1)
    is_repeated(live)


def test_on_loss_detach_detaches_the_nodes_of_a_lost_host(far: FarHosts, launch: Launch) -> None:
    detach = ("--set", "nodes.high.on_loss=detach", "--set", "nodes.high.rejoin_timeout=1")
    live = launch(far.hosts(robot="lost_after: 2") + "place: {high: robot}\n", *detach)
    live.goes_on()
    far.power_off(ROBOT)
    lost = int(live.launch.says("high: its process is lost in epoch").split()[-1])
    live.goes_on()
    assert "high" not in live.run["nodes"]
    far.power_on(ROBOT)
    live.launch.says("host robot is there again")
    live.goes_on()
    assert "high" not in live.run["nodes"]
    is_repeated(live, f"{lost}:detach:high")


def test_on_loss_stop_ends_the_run_when_a_host_is_lost(far: FarHosts, launch: Launch) -> None:
    stop = ("--set", "nodes.low.on_loss=stop", "--set", "nodes.low.rejoin_timeout=1")
    live = launch(far.hosts(robot="lost_after: 2") + "place: {low: robot, high: arm}\n", *stop)
    live.goes_on()
    far.power_off(ROBOT)
    assert live.launch.ends() == 1
    why = "low: it did not come back in time (rejoin_timeout); its process ended with host robot"
    assert [line for line in live.launch.err if line.startswith("error: ")] == [f"error: {why}\n"], live.launch.err
    assert live.launch.err[-1] == f"error: {why}\n"
    until(lambda: far.is_idle(ARM), "the end of the other host's keeper")
    log = live.hierax("logs").stdout.splitlines()
    assert log[-1].endswith(f"the run is broken off: {why}"), log


def test_certificates_are_renewed_on_all_hosts(far: FarHosts, launch: Launch) -> None:
    live = launch(far.hosts() + "certificates_s: 20\nplace: {world: robot, low: arm, high: desk}\n")
    until(lambda: sorted(renewed(live).values()) >= [4] * 3, "new certificates", 400.0)
    live.goes_on()
    is_repeated(live)
    late = "hierax: refused somebody: its certificate has ended"  # a link's last try with the one before
    assert [line for line in said_otherwise(live) if not line.startswith(late)] == []


@pytest.mark.skipif(shutil.which("rsync") is None, reason="folders are copied by `rsync`, which is missing")
def test_a_host_that_has_none_of_the_files_gets_them(far: FarHosts, launch: Launch, tmp_path: Path) -> None:
    more = with_own_module(far, tmp_path)
    live = launch(more, "--sync", "--state", str(tmp_path / "state"), settings=[OWN])
    live.goes_on()
    assert states(live)["low"] == ("running", ROBOT, 0)
    there = sorted(path.name for path in far.seen_there(ROBOT, tmp_path).iterdir())
    assert [name for name in there if name != "__pycache__"] == ["live.yaml", "own_drawer.py"]
    is_repeated(live)
    assert said_otherwise(live, f"host robot has a copy of {tmp_path} in {tmp_path}") == []


def test_nothing_is_copied_unless_that_is_said(far: FarHosts, launch: Launch, tmp_path: Path) -> None:
    file = tmp_path / "live.yaml"
    file.write_text(DEPLOYMENT.format(stop=tmp_path / "stop") + with_own_module(far, tmp_path), encoding="utf-8")
    done = hierax(tmp_path, "launch", str(file), "--set", OWN, namespace=far.namespaces[DESK])
    assert done.returncode == 1, done
    assert "own_drawer" in done.stderr.splitlines()[-1], done.stderr
    assert list(far.seen_there(ROBOT, tmp_path).iterdir()) == []


@pytest.mark.skipif(not FAKETIME.exists(), reason="a clock that goes wrong needs Debian's package faketime")
def test_nothing_depends_on_a_hosts_clock(far: FarHosts, launch: Launch, tmp_path: Path) -> None:
    wrong = (f"export LD_PRELOAD={FAKETIME} FAKETIME=+1h FAKETIME_DONT_FAKE_MONOTONIC=1", f'exec {sys.executable} "$@"')
    python = script(tmp_path / "an_hour_ahead", wrong)
    live = launch(far.hosts(python=python) + "place: {world: robot, low: robot}\n")
    live.goes_on()
    (key,) = (tmp_path / "hierax").glob("*.key")
    assert key.exists()
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"])["digest"]
    logs = hierax(tmp_path, "logs", "--run", "live", "--node", "low", "--format", "json").stdout.splitlines()
    ours = hierax(tmp_path, "logs", "--run", "live", "--node", "high", "--format", "json").stdout.splitlines()
    assert json.loads(logs[0])["time"] > json.loads(ours[-1])["time"], "the clock was not an hour ahead"


# --- what cannot be used is told in a line, before the first epoch


def refused(far: FarHosts, folder: Path, hosts: str) -> str:
    """What a launch says that does not come to run."""
    file = folder / "refused.yaml"
    text = "hierarchy: refused\nworld: world\nnodes: {world: {class: 'hierax.nodes.letters:SymbolWorld'}}\n"
    file.write_text(text + hosts + "place: {world: robot}\n", encoding="utf-8")
    done = hierax(folder, "launch", str(file), "--epochs", "1", namespace=far.namespaces[DESK])
    assert done.returncode == 1, done
    (line,) = done.stderr.splitlines()
    beginning = f"error: {file}:4: hosts.robot: "
    assert line.startswith(beginning), line
    return line.removeprefix(beginning)


def one_host(far: FarHosts, ssh: str = ROBOT, python: str = sys.executable) -> str:
    return f'hosts: {{robot: {{ssh: "-F {far.ssh_config} {ssh}", python: {python}}}}}\n'


def test_a_host_that_nobody_knows(far: FarHosts, tmp_path: Path) -> None:
    line = refused(far, tmp_path, one_host(far, "nowhere.invalid"))
    assert line.startswith("cannot be reached: ssh: Could not resolve hostname nowhere.invalid"), line
    assert line.endswith("expected `ssh -F " + f"{far.ssh_config} nowhere.invalid` to log in without a question")


def test_a_host_whose_ssh_does_not_answer(far: FarHosts, tmp_path: Path) -> None:
    line = refused(far, tmp_path, one_host(far, "-p 2223 robot"))
    assert line.startswith("cannot be reached: ssh: connect to host 10.213.79.2 port 2223: Connection refused"), line


def test_a_host_that_takes_another_key(far: FarHosts, tmp_path: Path) -> None:
    line = refused(far, tmp_path, one_host(far, "-o PubkeyAuthentication=no robot"))
    assert line.startswith("cannot be reached: "), line
    assert "Permission denied" in line


def test_a_python_that_is_not_there(far: FarHosts, tmp_path: Path) -> None:
    line = refused(far, tmp_path, one_host(far, python="~/no such/python"))
    assert line.startswith("there is no Python '~/no such/python': "), line
    assert line.endswith("expected the command there that has hierax")


def test_a_python_without_hierax(far: FarHosts, tmp_path: Path) -> None:
    line = refused(far, tmp_path, one_host(far, python=script(tmp_path / "bare", [f'exec {sys.executable} -S "$@"'])))
    assert line.startswith(f"hierax is not installed for {tmp_path / 'bare'} there: "), line
    assert "expected the one of this machine: version " in line


def copied(folder: Path) -> Path:
    """A copy of all that is hashed, as it is installed; what it holds is found before all else."""
    import hierax.nodes
    import hierax.runtime
    import hierax.runtime.front
    import hierax.schemas

    rooms = {"": hierax.runtime.front, "runtime": hierax.runtime, "schemas": hierax.schemas, "nodes": hierax.nodes}
    for name, package in rooms.items():
        shutil.copytree(Path(next(iter(package.__path__))), folder / "hierax" / name, dirs_exist_ok=True)
    return folder


def test_another_hierax_is_refused_and_the_same_one_elsewhere_is_not(
    far: FarHosts, launch: Launch, tmp_path: Path
) -> None:
    there = copied(tmp_path / "there")
    python = script(tmp_path / "other", [f"export PYTHONPATH={there}", f'exec {sys.executable} "$@"'])
    live = launch(far.hosts(python=python) + "place: {low: robot}\n")
    live.goes_on()
    is_repeated(live)
    changed = there / "hierax" / "runtime" / "engine" / "engine.py"
    changed.write_text(changed.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    line = refused(far, tmp_path, one_host(far, python=python))
    assert line.startswith("hierax there is another one: version "), line


def test_a_hierax_without_a_keeper_is_another_one(far: FarHosts, tmp_path: Path) -> None:
    there = copied(tmp_path / "there")
    (there / "hierax" / "runtime" / "launch" / "keeper.py").unlink()
    paths = f"{there}:{sysconfig.get_path('purelib')}"  # `-S`: what else is installed does not stand in for it
    python = script(tmp_path / "old", [f"export PYTHONPATH={paths}", f'exec {sys.executable} -S "$@"'])
    line = refused(far, tmp_path, one_host(far, python=python))
    assert line.startswith(f"hierax of {python} there is another version: "), line
