"""What a replayed node would have done otherwise, and in which epochs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT, FLAW, Level
from support.recorded import record_file

from hierax.runtime import Elements
from hierax.runtime.recording.decisions import Decisions
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of, other_settings

EPOCHS = 12


class Stubborn(Level):
    """Does the same whatever is asked."""

    def policies(self) -> Mapping[str, Callable[..., Elements]]:
        return dict.fromkeys(super().policies(), lambda belief: ({"by": 3.0},))


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    path = tmp_path / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return record_file(tmp_path / "run.mcap", path)[0]


def decided(recording: Recording, *settings: str, tolerance: float = 0.0, **options: object) -> Decisions:
    rewrite = other_settings(recording.info, settings, {})
    replay = Replay(recording, allowance_of(recording), rewrite=rewrite, **options)  # type: ignore[arg-type]
    decisions = Decisions(tolerance)
    decisions.gather(replay.epochs())
    return decisions


def test_what_is_done_again_as_it_was_decides_as_it_did(recording: Recording) -> None:
    decisions = decided(recording)
    assert decisions.compared == {"low": EPOCHS, "high": EPOCHS}
    assert not decisions.stretches
    assert decisions.otherwise("low") == 0


def test_a_policy_or_an_action_in_one_epoch_is_a_stretch_of_one(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FLAW, "low/select_policy/4")
    (only,) = decided(recording, node="low").stretches
    assert (only.node, only.first, only.last) == ("low", 4, 4)
    assert {only.recorded.policy, only.replayed.policy} == {"still", "move"}
    monkeypatch.setenv(FLAW, "high/policy/7")
    (only,) = decided(recording, node="high").stretches
    assert (only.first, only.last, only.recorded.policy) == (7, 7, only.replayed.policy)
    assert only.replayed.actions == ({"by": 7.0},)
    assert only.recorded.actions != only.replayed.actions


def test_epochs_in_a_row_that_differ_alike_are_one_stretch(recording: Recording) -> None:
    """Another class in the node's place does one and the same all the time."""
    rewrite = other_settings(recording.info, (), {"high": f"{__name__}:Stubborn"})
    replay = Replay(recording, allowance_of(recording).with_modules([__name__]), node="high", rewrite=rewrite)
    decisions = Decisions()
    decisions.gather(replay.epochs())
    (only,) = decisions.stretches
    assert (only.first, only.last, only.epochs) == (1, EPOCHS, EPOCHS)
    assert only.replayed.actions == ({"by": 3.0},)
    assert decisions.otherwise("high") == EPOCHS


def test_numbers_within_the_tolerance_are_no_other_decision(recording: Recording) -> None:
    assert decided(recording, "gain=0.5000001", node="low").otherwise("low") > 0
    assert decided(recording, "gain=0.5000001", node="low", tolerance=1e-3).otherwise("low") == 0
