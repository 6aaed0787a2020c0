"""Many simulations, over all cores, and how small a failing one can be made."""

import logging
import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from multiprocessing import active_children, get_context
from typing import NamedTuple, TypeVar

from hierax.runtime.core.errors import HierarchyError, HieraxError
from hierax.runtime.core.graph import check_graph
from hierax.runtime.execution.report import Json
from hierax.runtime.host.streams import started_deaf
from hierax.runtime.sim.journal import KINDS, Tally
from hierax.runtime.sim.rated import NOT_WITH_RATES, ONLY_WITH_RATES, with_rates
from hierax.runtime.sim.scenario import FAULTS, RATED_FAULTS, Scenario, draw_scenario
from hierax.runtime.sim.simulation import Result, simulate
from hierax.schemas.roster import Roster

CHUNK = 50  # how many seeds a worker takes at a time
AHEAD = 4  # how many chunks are given out for each worker: one takes longer than another

Item = TypeVar("Item")

MAX_SHRINKS = 400  # how many smaller scenarios are tried at most


class Scenarios(NamedTuple):
    """Of what kind they are, of all seeds."""

    faults: Collection[str] = FAULTS  # kinds that may occur
    epochs: int | None = None  # in each; None: the seed decides
    rated: bool = False  # whether nodes have rates

    def draw(self, seed: int) -> Scenario:
        if not self.rated:
            return draw_scenario(seed, self.faults, self.epochs)
        drawn = draw_scenario(seed, tuple(kind for kind in self.faults if kind in RATED_FAULTS), self.epochs)
        return with_rates(drawn)


ANY = Scenarios()


@dataclass
class Summary:
    """What came of many simulations."""

    seeds: int = 0  # how many were done
    violations: list[tuple[int, str]] = field(default_factory=list)  # what did not hold, and the seed
    tally: Tally = field(default_factory=Counter)  # how often each kind of thing occurred
    epochs: int = 0  # how many were committed
    answers: Counter[str] = field(default_factory=Counter)  # how many changes were made, and how many refused
    stopped: int = 0  # how many runs gave up, as they may where a checkpoint is damaged or a message forged

    def add(self, result: Result) -> None:
        self.seeds += 1
        self.tally.update(result.tally)
        self.epochs += result.epochs
        self.stopped += bool(result.stopped)
        self.answers.update("made" if answer.startswith("epoch") else "refused" for answer in result.answers.values())
        if result.violation:
            self.violations.append((result.seed, result.violation))

    @property
    def kinds(self) -> dict[str, dict[str, int]]:
        """How often each kind occurred, by what it is a kind of; all that there are."""
        return {group: {kind: self.tally[group, kind] for kind in kinds} for group, kinds in KINDS.items()}

    def unreached(self, rated: bool = False) -> list[str]:
        """The kinds that no seed has reached, but for those that cannot be where nodes have rates, or have none."""
        counts = {(group, kind): count for group, kinds in self.kinds.items() for kind, count in kinds.items()}
        left_out = NOT_WITH_RATES if rated else ONLY_WITH_RATES
        return [" ".join(each) for each, count in counts.items() if not count and each not in left_out]

    def plain(self) -> dict[str, Json]:
        return {
            "seeds": self.seeds,
            "violations": [{"seed": seed, "what": what} for seed, what in sorted(self.violations)],
            "kinds": {group: dict(kinds) for group, kinds in self.kinds.items()},
            "epochs": self.epochs,
            "changes": dict(sorted(self.answers.items())),
            "stopped": self.stopped,
        }


def simulate_many(
    seeds: range,  # which
    scenarios: Scenarios = ANY,  # of what kind
    jobs: int = 1,  # processes that share the work
    progress: Callable[[Summary], None] | None = None,  # told the summary so far, now and then
) -> Summary:
    summary = Summary()
    starts = range(0, len(seeds), CHUNK)
    chunks = (seeds[at : at + CHUNK] for at in starts)  # made as they are needed: there may be any number
    with closing(_done(chunks, scenarios, min(jobs, max(len(starts), 1)))) as done:
        for results in done:
            for result in results:
                summary.add(result)
            if progress is not None:
                progress(summary)
    return summary


def cores() -> int:
    return len(os.sched_getaffinity(0))


def shrink(scenario: Scenario, fails: Callable[[Scenario], bool]) -> Scenario:
    left = MAX_SHRINKS
    found = True
    while found and left:
        found = False
        for smaller in _smaller(scenario):
            left -= 1
            if fails(smaller):
                scenario, found = smaller, True
                break
            if not left:
                break
    return scenario


def fails(scenario: Scenario) -> bool:
    return bool(simulate_quietly(scenario).violation)


def _smaller(scenario: Scenario) -> Iterator[Scenario]:
    for index in range(len(scenario.faults)):
        yield replace(scenario, faults=_without(scenario.faults, index))
    for index in range(len(scenario.proposals)):
        yield replace(scenario, proposals=_without(scenario.proposals, index))
    for epochs in sorted({1, scenario.epochs // 2, scenario.epochs - 1} - {0, scenario.epochs}):
        yield replace(scenario, epochs=epochs)
    for name in sorted(scenario.roster.nodes):
        roster = _without_node(scenario.roster, name)
        if roster is not None:
            yield replace(scenario, roster=roster)
    for index, fault in enumerate(scenario.faults):
        if fault.number > 1:
            less = replace(fault, number=fault.number // 2)
            yield replace(scenario, faults=(*scenario.faults[:index], less, *scenario.faults[index + 1 :]))


def _without(items: tuple[Item, ...], index: int) -> tuple[Item, ...]:
    return (*items[:index], *items[index + 1 :])


def _without_node(roster: Roster, name: str) -> Roster | None:
    nodes = {other: reference for other, reference in roster.nodes.items() if other != name}
    edges = tuple(edge for edge in roster.edges if name not in edge.pair)
    try:
        check_graph(roster.world, nodes, [edge.pair for edge in edges])
    except HierarchyError:
        return None
    turns = {other: each for other, each in roster.turns.items() if other != name}
    return replace(roster, nodes=nodes, edges=edges, turns=turns)


def _done(chunks: Iterator[range], scenarios: Scenarios, jobs: int) -> Generator[list[Result], None, None]:
    """What comes of each chunk, in order. Raises `HieraxError` if a process that simulates has ended."""
    simulated = partial(simulate_chunk, scenarios=scenarios)
    if jobs <= 1:
        yield from map(simulated, chunks)
        return
    # forked, so that nothing is imported from the current folder; Ctrl-C is for who has started them
    ignoring = (signal.SIGINT, signal.SIG_IGN)
    with ProcessPoolExecutor(jobs, get_context("fork"), signal.signal, ignoring) as pool:
        try:
            with started_deaf():
                waiting = deque(pool.submit(simulated, each) for each in islice(chunks, AHEAD * jobs))
            while waiting:
                results = waiting.popleft().result()
                waiting.extend(pool.submit(simulated, each) for each in islice(chunks, 1))
                yield results
        except BrokenProcessPool as error:
            raise HieraxError("a process that simulates has ended") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():
                worker.kill()
            raise


def simulate_chunk(seeds: range, scenarios: Scenarios) -> list[Result]:
    return [simulate_quietly(scenarios.draw(seed)) for seed in seeds]


def simulate_quietly(scenario: Scenario, trace: list[str] | None = None) -> Result:
    """Simulate without the log lines of production code, which tell of every refused message."""
    log = logging.getLogger("hierax")
    before, log.disabled = log.disabled, True
    try:
        return simulate(scenario, trace)
    finally:
        log.disabled = before
