"""Seeing a run in this process."""

from __future__ import annotations

import time
from dataclasses import dataclass

from hierax.runtime.deployment import Deployment
from hierax.runtime.engine.effects import Completed
from hierax.runtime.execution import single
from hierax.runtime.execution.report import Report
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.watch.watcher import Watcher


def run_seen(deployment: Deployment, presenter: ViewPresenter, *, epochs: int | None, seed: int) -> Report:
    """Run a deployment in this process and show it; `HieraxError` as `single.run` has it, or if it cannot be shown."""
    presenter.set_roster(deployment.roster)
    clock = _Clock()

    def watch(name: str, runner: NodeRunner) -> None:
        runner.watch(_Seen(name, runner, presenter, clock))

    try:
        return single.run(deployment, epochs=epochs, seed=seed, watch=watch)
    finally:
        presenter.close()


class _Clock:
    """Time that stands still while things are drawn, as they are in the run's only thread."""

    def __init__(self) -> None:
        self._stood_s = 0.0
        self._since_s = 0.0

    def read_s(self) -> float:
        return time.perf_counter() - self._stood_s

    def __enter__(self) -> None:
        self._since_s = time.perf_counter()

    def __exit__(self, *error: object) -> None:
        self._stood_s += time.perf_counter() - self._since_s


@dataclass(eq=False)
class _Seen(Watcher):
    """Shows what one node does."""

    name: str
    runner: NodeRunner
    presenter: ViewPresenter
    clock: _Clock

    def __post_init__(self) -> None:
        self._begun_s = self.clock.read_s()
        self._took_s: tuple[int, float] | None = None

    def committed(self, epoch: int, digest: bytes) -> None:
        now_s = self.clock.read_s()
        self._took_s = (epoch, now_s - self._begun_s)
        self._begun_s = now_s

    def completed(self, completed: Completed) -> None:
        step = completed.step
        with self.clock:
            if self._took_s is not None and self._took_s[0] == step.epoch:
                self.presenter.epoch_took(step.epoch, step.time_s, self._took_s[1])
            self.presenter.step(self.name, self.runner.engine.node.node, step)
