"""Free running in one process: every node at its own rate, in virtual time."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from hierax.runtime.deployment import Deployment
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.runner import NodeRunner

UNIT_S = 1.0  # the period of a world without a rate; nodes without one are as quick as the quickest node


def run_freely(
    runners: Mapping[str, NodeRunner],
    deployment: Deployment,
    seed: int,
    pacemaker: Pacemaker,
    turn: Callable[[str], None],  # told whose turn it is
) -> Iterator[None]:
    """Run until the world is done; gives control back after every turn.

    A node's turns are a period apart, from a beginning that the seed draws. At each turn it takes in what has come, and
    takes part in the newest epoch. Which of two turns at the same time comes first is drawn, too: the same seed gives
    the same run. Raises `HieraxError` if a node failed, or a change of the roster is refused.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    quickest_s = min((1 / rate for rate in deployment.rates_hz.values()), default=UNIT_S)
    turns: list[tuple[float, float, str]] = []

    def plan(name: str, after_s: float) -> None:
        rate = deployment.rates_hz.get(name)
        heapq.heappush(turns, (after_s + (quickest_s if rate is None else 1 / rate), random.random(), name))

    for name in sorted(runners):
        plan(name, -random.random() * quickest_s)
    world = deployment.roster.world
    version = runners[world].engine.wiring.roster
    while not pacemaker.done:
        time_s, _, name = heapq.heappop(turns)
        if version != runners[world].engine.wiring.roster:
            version = runners[world].engine.wiring.roster
            for newcomer in sorted(runners.keys() - {turn[2] for turn in turns} - {name}):
                plan(newcomer, time_s)
        runner = runners.get(name)
        if runner is None:
            continue  # detached
        turn(name)
        while (message := runner.port.receive()) is not None:
            runner.step(message)
        runner.poll()
        plan(name, time_s)
        yield
