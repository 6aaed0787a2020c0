"""Commands that packages of nodes bring with them."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from hierax.runtime.commands.errors import FAILED, exit_code
from hierax.runtime.commands.main import _load


def test_a_command_of_the_nodes_is_found_by_its_entry_point() -> None:
    from hierax.nodes.commands.infer import infer

    assert _load(EntryPoint("infer", "hierax.nodes.commands.infer:infer", "hierax.commands")) is infer


def test_one_that_cannot_be_loaded_says_so_when_it_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    broken = _load(EntryPoint("weather", "no_such_package.commands:weather", "hierax.commands"))
    assert exit_code(broken) == FAILED
    said = capsys.readouterr().err
    assert said.startswith("error: no_such_package.commands:weather cannot be loaded: ModuleNotFoundError")
    assert said.count("\n") == 1
