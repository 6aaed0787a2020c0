"""One dry epoch: everything is called, and nothing comes of it."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import pytest
from support.deployments import write

from hierax.runtime.commands.main import main
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.deployment.deployment import shipped
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.dry import run_dry
from hierax.runtime.loading.loader import extend_import_path

NODES = """\
from pathlib import Path

from hierax.runtime import Node, Probe, World


class Rover(World):
    def initial_belief(self):
        return {"at": 0}

    def policies(self):
        return {"default": lambda belief: ("stop",), "turn": self.turn}

    def turn(self, belief):
        return ()

    def act(self, actions):
        Path(__file__).with_name("moved").touch()

    def predict(self, context, actions, belief):
        return {"at": belief["at"] + 1}


class Eye(Node):
    def initial_belief(self):
        return {"at": -1}

    def observe(self, observations, belief):
        return {"at": observations[0]["at"]}


class Told(Probe):
    def record(self, step):
        Path(__file__).with_name("told").touch()


def seen(belief):
    return (belief,)
"""

FILE = """\
hierarchy: dry
world: rover
nodes:
  rover: {class: "MODULE:Rover"}
  eye: {class: "MODULE:Eye"}
edges:
  rover -> eye: {sense: "MODULE:seen"}
probes:
  - {node: eye, class: "MODULE:Told"}
"""

_numbers = count()


def deployment(folder: Path, old: str = "", new: str = "") -> Path:
    """A file, and a module of its own beside it, with one part of that changed."""
    assert NODES.count(old) == 1 or not old
    module = f"hierax_test_dry{next(_numbers)}"
    (folder / f"{module}.py").write_text(NODES.replace(old, new) if old else NODES)
    return write(folder, FILE.replace("MODULE", module), "dry.yaml")


def test_everything_is_called_and_nothing_comes_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = deployment(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert main(["validate", str(path), "--dry"]) == 0
    assert "OK, 2 nodes, 1 edges, 10 dry calls, content " in capsys.readouterr().out
    assert [each for each in sorted(tmp_path.iterdir()) if each.name != "__pycache__"] == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'return {"at": observations[0]["at"]}',
            'return {"at": observations[1]["at"]}',
            "eye: observe in epoch 1: IndexError: tuple index out of range (MODULE.py:28, in observe)",
        ),
        (
            'return {"at": belief["at"] + 1}',
            'belief["at"] += 1',
            "rover: predict in epoch 1: gave None for the belief",
        ),
        (
            'return {"at": belief["at"] + 1}',
            'belief["at"] += 1; return belief',
            "rover: predict in epoch 1: changed the belief that it was given (belief.at: 0, then 1)",
        ),
        (
            "        return ()",
            "        return (object(),)",
            "rover: policy turn in epoch 1: its actions: value[0]: a object",
        ),
        ("    return (belief,)", "    return 1 / 0", "rover->eye: sense in epoch 1: ZeroDivisionError"),
        ("def observe(", "def observ(", "nodes.eye.class: MODULE:Eye defines 'observ', which nothing calls; did you"),
        ("class Eye(Node)", "class Eye(World)", "nodes.eye: only N₀ may derive from World, and Eye does"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = deployment(tmp_path, old, new)
    assert main(["validate", str(path), "--dry"]) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1, error
    module = next(tmp_path.glob("hierax_test_dry*.py")).stem
    assert message.replace("MODULE", module) in error.replace(f"{tmp_path}/", "")


def test_a_near_operator_is_told_of_in_a_run(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = deployment(tmp_path, "def observe(", "def observ(")
    assert main(["run", str(path), "--epochs", "1"]) == 0
    assert [record.getMessage()[:4] for record in caplog.records] == ["eye:"]
    assert "defines 'observ', which nothing calls; did you mean 'observe'?" in caplog.text


def test_a_run_says_which_operator_gave_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = deployment(tmp_path, 'return {"at": observations[0]["at"]}', "pass")
    assert main(["run", str(path), "--epochs", "1"]) == 1
    assert "eye: observe in epoch 1: gave None for the belief" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name in sorted(shipped()) if name not in ("tracking", "pick", "tower")])
def test_the_shipped_ones_stand_it(name: str) -> None:
    file = read_deployment(name)
    extend_import_path(file.import_paths)
    assert run_dry(file) > 10


def test_an_error_of_a_dry_run_is_an_operators(tmp_path: Path) -> None:
    file = read_deployment(deployment(tmp_path, "    return (belief,)", "    return 1 / 0"))
    extend_import_path(file.import_paths)
    with pytest.raises(OperatorError, match="rover->eye: sense in epoch 1"):
        run_dry(file)


def test_a_node_that_would_be_detached_for_what_it_raises_is_no_less_wrong(tmp_path: Path) -> None:
    failing = ["nodes.left.class=support.toy_nodes:Failing", "nodes.left.on_loss=detach"]
    with pytest.raises(OperatorError, match="left: observe in epoch 1: RuntimeError: the camera is gone"):
        run_dry(read_deployment(write(tmp_path), failing))
