"""A node on the inputs that it had in a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from support.deployments import write
from support.toy_nodes import Summer

from hierax.runtime import Elements, Value
from hierax.runtime.commands.main import main
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.testing.runs import Recorded

EPOCHS = 6


@pytest.fixture
def file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A recording of the toys."""
    path = tmp_path / "toys.mcap"
    command = ["run", str(write(tmp_path)), "--epochs", str(EPOCHS), "--seed", "4", "--record", str(path)]
    assert main(command) == 0, capsys.readouterr().err
    return path


class Late(Summer):
    """As it was, but for the fourth epoch."""

    def observe(self, observations: Elements, belief: Value) -> Value:
        belief = super().observe(observations, belief)
        return belief + 1 if observations == (6.0,) else belief


@pytest.mark.parametrize("node", ["left", "top.most", "world"])
def test_it_does_again_what_it_did(hierax_recorded: Callable[..., Recorded], file: Path, node: str) -> None:
    recorded = hierax_recorded(file, node)
    steps = recorded.check()
    assert [step.epoch for step in steps] == list(range(1, EPOCHS + 1))
    assert [step.belief for step in steps] == recorded.beliefs


def test_inputs_are_those_of_the_run(hierax_recorded: Callable[..., Recorded], file: Path) -> None:
    recorded = hierax_recorded(file, "left", epochs=3)
    assert [each.observations for each in recorded.inputs] == [(0.0,), (2.0,), (4.0,)]
    assert (recorded.below, recorded.above, recorded.seed) == (("world",), ("top.most",), 4)
    assert recorded.reference.target == "support.toy_nodes:Summer"


def test_another_node_in_its_place(hierax_recorded: Callable[..., Recorded], file: Path) -> None:
    recorded = hierax_recorded(file, "left")
    assert recorded.run(Late())[2].belief == recorded.beliefs[2]
    with pytest.raises(AssertionError, match=r"left: epoch 4 is not as recorded \(belief: 12\.0, then 13\.0\)"):
        recorded.check(Late())


def test_what_cannot_be_had_is_told(hierax_recorded: Callable[..., Recorded], file: Path) -> None:
    with pytest.raises(HieraxError, match=r"there is no node 'lfet' in it; did you mean 'left'"):
        hierax_recorded(file, "lfet")
    with pytest.raises(HieraxError, match=r"none\.mcap"):
        hierax_recorded("none.mcap", "left")
