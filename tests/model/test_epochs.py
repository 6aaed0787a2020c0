"""The model of the protocol holds, and each of its mistakes is found; docs/model.md says what is modelled."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.spin import Model, needs_spin
from support.sweep import SWEEP

MODEL = Model(Path(__file__).with_name("epochs.pml"), r"\d|world|owner|refused")
LIMITS = r"filled\[|plan<"

pytestmark = needs_spin

SOUND = {
    "attach": "ATTACH REDOS=1",
    "diamond, attach": "DIAMOND ATTACH",
    "two crashes": "CRASHES=2",
    "damage, replace": "DAMAGE REPLACE",
}
FURTHER = {
    "redo": "REDOS=1",
    "replace": "REPLACE REDOS=1",
    "diamond": "DIAMOND REDOS=1",
    "diamond, replace": "DIAMOND REPLACE",
    "damage": "DAMAGE REDOS=1",
    "damage, attach": "DAMAGE ATTACH",
}
"""Those that `make model` goes through besides."""

MISTAKES = {
    "STALE_ATTEMPT": "REDOS=1",
    "ATTEMPT_REUSED": "",
    "SINGLE_PHASE": "ATTACH",
    "VERSION_REUSED": "ATTACH",
    "IGNORE_INSTANCE": "REPLACE",
    "WRONG_ROLLBACK": "",
    "WRONG_START": "",
    "NODE_COMMITS": "",
    "COMMIT_EARLY": "",
    "RECORD_LATE": "",
    "CHECKPOINT_LATE": "",
    "CHECKPOINT_SKIPPED": "",
    "HANDOVER_MIDWAY": "REPLACE",
    "HANDOVER_NOT_SAVED": "REPLACE",
    "DISMISSED_EARLY": "REPLACE",
    "JOIN_WITHOUT_CHECKPOINT": "DAMAGE",
    "JOIN_CHECKED_ONCE": "DAMAGE",
    "JOIN_ANY_ATTEMPT": "DAMAGE REDOS=1",
}


@pytest.mark.parametrize("macros", [*SOUND.values(), *(FURTHER.values() if SWEEP else ())])
def test_the_protocol_holds_and_every_run_ends(macros: str, tmp_path: Path) -> None:
    MODEL.check_holds(macros, tmp_path)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found(mistake: str, tmp_path: Path) -> None:
    MODEL.check_finds(mistake, MISTAKES[mistake], LIMITS, tmp_path)


def test_a_deadlock_is_a_run_that_does_not_end(tmp_path: Path) -> None:
    macros = ["MUT_SINGLE_PHASE"]
    MODEL.build(tmp_path, macros)
    assert MODEL.verdict(tmp_path, macros, "-a").startswith("acceptance cycle")


def test_every_mistake_of_the_model_is_tried() -> None:
    assert MODEL.mistakes() == MISTAKES.keys()
