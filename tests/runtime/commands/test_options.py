"""One dataclass has the options of all that runs a deployment; each command offers some of them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest
import typer

from hierax.runtime.commands.launch import launch
from hierax.runtime.commands.main import app_of
from hierax.runtime.commands.options import RunOptions
from hierax.runtime.commands.replay import replay
from hierax.runtime.commands.run import run
from hierax.runtime.commands.view import view

OFFERING = {command.__name__: command for command in (run, launch, replay, view)}


def test_every_option_is_offered_by_a_command_and_no_command_offers_another() -> None:
    offered = {name for command in OFFERING.values() for name in vars(command)["offers"]}
    assert offered == {field.name for field in fields(RunOptions)}


@pytest.mark.parametrize("name", sorted(OFFERING))
def test_a_command_has_its_argument_and_what_it_offers(name: str) -> None:
    group: Any = typer.main.get_command(app_of([]))
    parameters = [parameter.name for parameter in group.commands[name].params]
    assert sorted(parameters[1:]) == sorted(vars(OFFERING[name])["offers"])
    assert parameters[0] in ("file", "source")
