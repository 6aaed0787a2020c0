"""A witness tells every epoch; one that was not listened to counts what it has not told."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution import single
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.recording.check import Checker
from hierax.runtime.recording.ledger import Ledger
from hierax.runtime.recording.witness import Witness
from hierax.schemas.errors import SchemaError
from hierax.schemas.steps import NodeStep, Passage, decode_step, encode_step


class Deaf(Witness):
    """Is not listened to from one epoch on, until another one."""

    def __init__(self, runner: NodeRunner, told: list[NodeStep], gone: int, back: int) -> None:
        super().__init__("low", lambda: runner.engine, lambda data: told.append(decode_step(data)), lambda _: None)
        self._away = (gone, back)

    def completed(self, completed: object) -> None:
        epoch = completed.step.epoch  # type: ignore[attr-defined]
        gone, back = self._away
        if epoch == back:
            self.resume()
        elif not gone <= epoch < back:
            super().completed(completed)  # type: ignore[arg-type]


class Late(Witness):
    """Sees nothing before the node has sensed in its first epoch."""

    def __init__(self, runner: NodeRunner, told: list[NodeStep]) -> None:
        super().__init__("low", lambda: runner.engine, lambda data: told.append(decode_step(data)), lambda _: None)
        self._sees = False

    def _passed(self, passage: Passage) -> None:
        if self._sees:
            super()._passed(passage)
        elif passage.sent:
            self._sees = True
            self.resume()
            self.look()


def steps(tmp_path: Path, gone: int, back: int) -> list[NodeStep]:
    """The steps of the node in the middle."""
    path = tmp_path / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    told: list[NodeStep] = []

    def watch(name: str, runner: NodeRunner) -> None:
        if name == "low":
            runner.watch(Deaf(runner, told, gone, back))

    single.run(read_deployment(path), epochs=12, seed=0, watch=watch)
    return told


def test_every_epoch_is_told(tmp_path: Path) -> None:
    told = steps(tmp_path, 100, 101)
    assert [(step.epoch, step.number) for step in told] == [(epoch, epoch) for epoch in range(1, 13)]
    assert len({step.stream for step in told}) == 1
    assert [bool(step.start) for step in told] == [True, *[False] * 11]
    assert all(len(step.passages) == 6 for step in told)
    assert all(step.sensed and not step.chain for step in told)


def test_what_nobody_was_told_of_is_a_gap(tmp_path: Path) -> None:
    told = steps(tmp_path, 5, 8)
    assert [step.epoch for step in told] == [1, 2, 3, 4, 9, 10, 11, 12]
    assert [step.number for step in told] == [1, 2, 3, 4, 9, 10, 11, 12]
    assert [bool(step.start) for step in told] == [True, False, False, False, True, False, False, False]
    ledger = Ledger(from_start=True)
    for step in told:
        for sent, kind, peer, epoch, attempt in step.passages:
            ledger.message((kind, "low", peer) if sent else (kind, peer, "low"), epoch, attempt)
        ledger.step(step)
    gaps, lost = ledger.close()
    assert (lost, str(gaps[0])) == (4, "epoch 9: steps of low before this one")


@pytest.mark.parametrize(
    ("most", "kept"),
    [
        (420, [(1, False, True), (2, True, False), (3, True, False)]),
        (300, [(1, False, False), (2, False, False), (3, False, False)]),
        (100, []),
    ],
)
def test_a_step_that_is_larger_than_a_message_may_be_ends_no_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    most: int,
    kept: list[tuple[int, bool, bool]],
) -> None:
    def bounded(step: NodeStep) -> bytes:
        data = encode_step(step)
        if len(data) > most:
            raise SchemaError(f"has {len(data)} bytes; at most {most} are allowed", "value")
        return data

    monkeypatch.setattr("hierax.runtime.recording.witness.encode_step", bounded)
    told = steps(tmp_path, 4, 100)
    assert [(step.number, bool(step.sensed), bool(step.start)) for step in told] == kept
    warned = [record.getMessage() for record in caplog.records if record.name == "hierax"]
    assert [each.partition(" bytes")[0] for each in warned] == [
        f"epoch {epoch} of low is not recorded: its step has {size}"
        for epoch, size in enumerate((259, 259, 258) if not kept else (), 1)
    ]


def test_who_listens_late_is_told_that_something_lacks_and_finds_no_fault_with_it(tmp_path: Path) -> None:
    path = tmp_path / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    told: list[NodeStep] = []

    def watch(name: str, runner: NodeRunner) -> None:
        if name == "low":
            runner.watch(Late(runner, told))

    deployment = read_deployment(path)
    single.run(deployment, epochs=3, seed=0, watch=watch)
    assert [(step.epoch, step.number) for step in told] == [(1, 2), (2, 3), (3, 4)]
    assert [len(step.passages) < 6 for step in told] == [True, False, False]
    ledger, checker = Ledger(from_start=True), Checker()
    checker.roster(deployment.roster)
    for step in told:
        ledger.step(step)
        checker.step(step)
    assert "epoch 1: steps of low before this one" in map(str, ledger.close()[0])
    assert checker.violations == []
