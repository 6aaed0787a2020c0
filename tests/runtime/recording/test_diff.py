"""A flaw in one operator of one node in one epoch is named as that, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.flawed import DEPLOYMENT, FLAW, OPERATORS
from support.recorded import record_file

from hierax.runtime.core.difference import ABSENT, Unlike, first_unlike
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of, in_place_of

FLAWS = [(subject, operator) for subject, operators in OPERATORS.items() for operator in operators]
EPOCH = 7


@pytest.fixture
def flawed(tmp_path: Path) -> Path:
    path = tmp_path / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return path


@pytest.fixture
def sound(flawed: Path, tmp_path: Path) -> Recording:
    return record_file(tmp_path / "sound.mcap", flawed)[0]


@pytest.mark.parametrize(("subject", "operator"), FLAWS)
def test_a_flaw_is_named_between_two_recordings(
    subject: str, operator: str, flawed: Path, sound: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FLAW, f"{subject}/{operator}/{EPOCH}")
    other, _ = record_file(tmp_path / "other.mcap", flawed)
    comparison = compare(sound.epochs(), other.epochs())
    named = comparison.difference
    assert named is not None
    assert (named.epoch, named.subject) == (EPOCH, subject)
    assert named.operator.split()[0] == operator
    assert comparison.equal == EPOCH - 1
    assert not comparison.rosters


@pytest.mark.parametrize(("subject", "operator"), FLAWS)
def test_a_flaw_is_named_between_a_recording_and_a_deployment(
    subject: str, operator: str, flawed: Path, sound: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FLAW, f"{subject}/{operator}/{EPOCH}")
    rewrite = in_place_of(sound.rosters()[0], read_deployment(flawed))
    named = compare(sound.epochs(), Replay(sound, allowance_of(sound), world=True, rewrite=rewrite).epochs()).difference
    assert named is not None
    assert (named.epoch, named.subject) == (EPOCH, subject)
    assert named.operator.split()[0] == operator


def test_field_and_both_values_are_said(
    flawed: Path, sound: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FLAW, f"high/predict/{EPOCH}")
    other, _ = record_file(tmp_path / "other.mcap", flawed)
    named = compare(sound.epochs(), other.epochs()).difference
    assert named is not None
    assert named.path == "belief.trail[2]"
    assert named.b == named.a + 0.25
    assert compare(sound.epochs(), other.epochs(), tolerance=1.0).alike


def test_numbers_within_the_tolerance_are_alike() -> None:
    near = {"a": (1.0, 2.0), "b": np.array([100.0, 0.0])}
    far = {"a": (1.0, 2.0 + 1e-9), "b": np.array([100.0, 1e-9])}
    assert first_unlike(near, far, "x") == Unlike("x.a[1]", 2.0, 2.0 + 1e-9)
    assert first_unlike(near, far, "x", tolerance=1e-8) is None


@pytest.mark.parametrize(
    ("a", "b", "path"),
    [
        ({"k": 1}, {"k": 1, "l": 2}, "x.l"),
        ((1, 2), (1,), "x[1]"),
        (1, 1.0, "x"),
        (0.0, -0.0, "x"),
        (True, 1, "x"),
        (np.zeros(3), np.zeros(3, np.float32), "x (array)"),
        (np.zeros((2, 2)), np.zeros(4), "x (array)"),
        (np.array([[1, 2], [3, 4]]), np.array([[1, 2], [3, 5]]), "x[1][1]"),
        (np.array([0.0, 1.0]), np.array([-0.0, 2.0]), "x[0] (and 1 more of 2)"),
        ({"k": 1, "l": 2}, {"l": 2, "k": 1}, "x (order of keys)"),
    ],
)
def test_what_differs_in_a_bit_differs(a: object, b: object, path: str) -> None:
    unlike = first_unlike(a, b, "x")
    assert unlike is not None
    assert unlike.path == path


def test_not_a_number_is_like_itself() -> None:
    value = {"a": float("nan"), "b": np.array([np.nan, np.inf])}
    assert first_unlike(value, dict(value), "x") is None
    assert first_unlike({"a": 1}, {"a": 1}, "x") is None
    assert first_unlike((), (1,), "x") == Unlike("x[0]", ABSENT, 1)
