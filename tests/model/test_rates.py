"""The model of epochs with rates holds, and each of its mistakes is found; docs/model.md says what is modelled."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.spin import Model, needs_spin
from support.sweep import SWEEP

MODEL = Model(Path(__file__).with_name("rates.pml"), r"\d|world|refused")
LIMITS = "newest<"

pytestmark = needs_spin

SOUND = {
    "a delay": "DELAY=1",
    "every second epoch, gathered": "EVERY=2 OFFSET=1 GATHER",
    "two deaths": "CRASHES=2 EPOCHS=2",
    "damage": "DAMAGE EPOCHS=3",
}
FURTHER = {
    "no delay": "DELAY=0",
    "a longer delay": "DELAY=2",
    "every second epoch": "EVERY=2",
    "every second epoch, five": "EVERY=2 DELAY=2 GATHER EPOCHS=5",
    "delays on both edges": "DELAY_WORLD=1",
    "delays on both edges, every second epoch": "DELAY_WORLD=1 EVERY=2 OFFSET=1",
    "two deaths, three epochs": "CRASHES=2 EPOCHS=3",
    "two deaths, every second epoch, gathered": "CRASHES=2 EVERY=2 GATHER",
    "damage, four epochs": "DAMAGE",
    "damage, every second epoch": "DAMAGE EVERY=2 GATHER",
}
"""Those that `make model` goes through besides."""

MISTAKES = {
    "FORGETS_IN_FORCE": "",
    "FORGETS_OBSERVED": "",
    "NOT_KEPT": "",
    "SAID_NOT_SAVED": "",
    "CHECKPOINT_LATE": "",
    "SAVED_WITHOUT_NEXT": "",
    "NOTHING_AGAIN": "",
    "NEWEST_AGAIN": "",
    "NOBODY_GREETS": "",
    "SENSES_ANEW": "",
    "SAVES_BETWEEN": "EVERY=2 GATHER",
    "GATHERED_FORGOTTEN": "EVERY=2 GATHER",
    "TOLD_OF_TURNS_ALONE": "EVERY=2 GATHER",
    "NEWEST_COUNTS": "",
    "DELAYS_LEFT_OUT": "",
    "NO_DRAIN": "",
    "NO_EMPTY_CONTEXT": "EVERY=2 OFFSET=1",
    "RECORD_LATE": "",
    "ACTS_AGAIN": "",
    "GREETING_NOT_JUDGED": "DAMAGE EPOCHS=3",
}


@pytest.mark.parametrize("macros", [*SOUND.values(), *(FURTHER.values() if SWEEP else ())])
def test_the_protocol_holds_and_every_run_ends(macros: str, tmp_path: Path) -> None:
    MODEL.check_holds(macros, tmp_path)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found(mistake: str, tmp_path: Path) -> None:
    MODEL.check_finds(mistake, MISTAKES[mistake], LIMITS, tmp_path)


def test_every_mistake_of_the_model_is_tried() -> None:
    assert MODEL.mistakes() == MISTAKES.keys()
