"""Processes that are started: a user's module never stands in another's place, and Ctrl-C is none of their business."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.launched import Command, until

from hierax.runtime.host.streams import python_code, python_module, started_deaf

OWN = """
from hierax.runtime import Node, World

class Watcher(Node):
    def initial_belief(self):
        return 1

class Counter(World):
    def initial_belief(self):
        return 0

    def predict(self, context, actions, belief):
        return belief + 1
"""
DEPLOYMENT = """
hierarchy: shadowed
world: world
modules: [queue_of_mine, of_mine]
nodes:
  world: {class: "queue_of_mine:Counter"}
  node: {class: "queue_of_mine:Watcher"}
edges:
  world -> node: {}
"""
SHADOWS = ("signal", "queue", "selectors", "typing", "numpy", "msgpack", "zenoh", "anyio", "mcap", "pydantic")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """One whose modules end whoever imports them, but for one."""
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text(f"raise SystemExit('the user\\'s {name}.py is imported')\n")
    (tmp_path / "queue_of_mine.py").write_text(OWN)
    (tmp_path / "shadowed.yaml").write_text(DEPLOYMENT)
    return tmp_path


def hierax(folder: Path, *arguments: str) -> str:
    command = [str(Path(sys.executable).with_name("hierax")), *arguments]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["XDG_RUNTIME_DIR"] = str(folder)
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert "the user's" not in done.stdout + done.stderr
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_launch_and_its_recorder_are_those_of_one_process(folder: Path) -> None:
    options = ("shadowed.yaml", "--epochs", "5", "--format", "json", "--record")
    launched, run = (json.loads(hierax(folder, mode, *options, f"{mode}.mcap")) for mode in ("launch", "run"))
    assert launched["digest"] == run["digest"]
    assert launched["nodes"]["world"]["belief"] == 5


def test_simulations_on_several_cores(folder: Path) -> None:
    assert "110 seeds" in hierax(folder, "sim", "--seeds", "0:110", "--faults", "none", "--epochs", "1", "--jobs", "2")


def test_what_is_imported_to_see_whether_it_can_be(folder: Path) -> None:
    command = python_code("import queue; print(queue.__file__, *sys.argv)", "a", "b")
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    assert str(folder) not in done.stdout
    assert done.stdout.endswith(" a b\n")


SIGNALS = "print(open('/proc/self/status').read())"


def of_ctrl_c(status: str) -> dict[str, bool]:
    """By a process's status, whether Ctrl-C is blocked, and whether it is ignored."""
    lines = (line.split() for line in status.splitlines() if line.startswith(("SigBlk:", "SigIgn:")))
    return {name: bool(int(mask, 16) & 1 << (signal.SIGINT - 1)) for name, mask in lines}


def test_what_is_started_is_deaf_to_ctrl_c_from_its_first_instant_and_then_ignores_it() -> None:
    own = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with started_deaf():
        at_first = subprocess.run(["cat", "/proc/self/status"], capture_output=True, text=True, check=True).stdout
        later = subprocess.run(python_code(SIGNALS), capture_output=True, text=True, check=True).stdout
    assert of_ctrl_c(at_first)["SigBlk:"]
    assert of_ctrl_c(later) == {"SigBlk:": False, "SigIgn:": True}
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == own


@pytest.mark.parametrize("safe", [{}, {"PYTHONSAFEPATH": "1"}])
def test_what_the_user_puts_on_the_path_stays_there(folder: Path, safe: dict[str, str]) -> None:
    (folder / "here.py").write_text("import sys; print(__name__, sys.argv)\n")
    environment = {**os.environ, **safe, "PYTHONPATH": str(folder / "further")}
    (folder / "further").mkdir()
    (folder / "here.py").rename(folder / "further" / "here.py")
    done = subprocess.run(
        python_module("here", "x"), cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"__main__ ['{folder / 'further' / 'here.py'}', 'x']\n"


def test_nodes_that_are_kept_by_who_attaches_them_find_their_modules(folder: Path) -> None:
    for name in SHADOWS:  # `python -m`, as the tests start it, looks here first
        (folder / f"{name}.py").unlink()
    (folder / "of_mine.py").write_text("from queue_of_mine import Watcher\n\nclass Further(Watcher): pass\n")
    (folder / "more.yaml").write_text('nodes:\n  more: {class: "of_mine:Further"}\nedges:\n  world -> more: {}\n')
    paced = f'{DEPLOYMENT}probes: [{{node: world, class: "support.pace:Pace"}}]\n'
    (folder / "shadowed.yaml").write_text(paced)
    with Command(folder, "launch", str(folder / "shadowed.yaml"), "--epochs", "10000000") as launch:
        until(lambda: any((folder / "hierax").glob("*.json")), "the launch runs")
        with Command(folder, "attach", str(folder / "more.yaml"), "--here") as keeper:
            until(lambda: any("attached more" in line for line in keeper.printed) or not keeper.running, "it is there")
            assert keeper.running, keeper.err
            os.kill(keeper.process.pid, signal.SIGINT)
            keeper.end()
        os.kill(launch.process.pid, signal.SIGINT)
        launch.end()
