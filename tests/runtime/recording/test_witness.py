"""A witness tells every epoch; one that was not listened to counts what it has not told."""

from __future__ import annotations

from pathlib import Path

from support.flawed import DEPLOYMENT

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution import single
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.recording.ledger import Ledger
from hierax.runtime.recording.witness import Witness
from hierax.schemas.steps import NodeStep, decode_step


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
