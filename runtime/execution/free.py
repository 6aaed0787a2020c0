"""Free running in one process: every node at its own rate, in virtual time."""

import heapq
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.runner import NodeRunner

UNIT_S = 1.0  # the period of a world without a rate; nodes without one are as quick as the quickest node


def run_freely(
    runners: Mapping[str, NodeRunner],
    world: str,  # its name
    terms: Mapping[str, ProcessTerms],  # how nodes are kept, as they come and go
    seed: int,
    pacemaker: Pacemaker,
    turn: Callable[[str], None],  # told whose turn it is
) -> Iterator[None]:
    """Run until the world is done; gives control back after every turn.

    A node's turns are a period apart, from a beginning that the seed draws. At each turn it takes in what has come, and
    takes part in the newest epoch. Which of two turns at the same time comes first is drawn, too: the same seed gives
    the same run. Raises `HieraxError` if a node failed, or a change of the roster is refused."""
    random = np.random.Generator(np.random.PCG64(seed))
    quickest_s = min((1 / each.rate_hz for each in terms.values() if each.rate_hz), default=UNIT_S)
    turns: list[tuple[float, float, str]] = []

    def plan(name: str, after_s: float) -> None:
        rate_hz = terms[name].rate_hz if name in terms else None
        heapq.heappush(turns, (after_s + (1 / rate_hz if rate_hz else quickest_s), random.random(), name))

    for name in sorted(runners):
        plan(name, -random.random() * quickest_s)
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
