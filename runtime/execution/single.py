"""All nodes in one process: the deterministic mode, in virtual time, without event loop or threads."""

import gc
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.execution.output_folder import digest_log, write_roster
from hierax.runtime.execution.pacemaker import Breaker, Pacemaker
from hierax.runtime.execution.report import Interrupted, NodeReport, Report
from hierax.runtime.execution.single_nodes import RunRecord, Schedule, SingleNodes, Watch
from hierax.runtime.host.large_pages import into_large_pages
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.roster import Change

MANY = 100  # nodes, of which an epoch goes through more memory than the processor knows its way about in
MADE_A_NODE = 100  # so many objects a node are made, and not given back, before cycles among them are looked for


def run(
    deployment: Deployment,  # what to run
    *,
    breaker: Breaker | None = None,  # ends the run when a signal comes; None: nothing does
    **given: Any,  # as `SingleRun` has them
) -> Report:
    """Run a deployment in this process.

    Raises `HieraxError` if a node cannot be loaded or failed, or a change is refused, and `Interrupted` if the breaker
    has ended it."""
    single = SingleRun(deployment, **given)
    with closing(single), nullcontext() if breaker is None else breaker.guarding(single.pacemaker):
        deque(single.epochs(), maxlen=0)
    return single.report(breaker is not None and breaker.came)


class SingleRun:
    """A run of a deployment in this process, which goes on as its epochs are asked for.

    Raises `HieraxError` if a node cannot be loaded."""

    def __init__(
        self,
        deployment: Deployment,  # what to run
        *,
        epochs: int | None,  # how many; None: the deployment's number, or until the world has finished
        seed: int,  # of all random numbers, and of the order in which messages are delivered
        output: Path | None = None,  # folder for the states, digests and what probes write; None: nothing is written
        progress: Callable[[int, bytes], None] | None = None,  # told each epoch that is committed, and its digest
        schedule: Schedule = (),  # what changes when, in order
        watch: Watch | None = None,  # called for each node as its runner is made
        record: RunRecord | None = None,  # takes in what is said; None: nobody does
        acts: bool = True,  # whether the world moves its actuators
        turn: Callable[[str], None] | None = None,  # told whose turn it is, before it
    ) -> None:
        if output is not None:
            write_roster(output, deployment.roster)
        self._deployment, self._seed, self._output, self._record = deployment, seed, output, record
        self._progress = progress
        self._told: deque[tuple[int, bytes]] = deque()
        self._digests = digest_log(output)
        chain = DigestChain(deployment.roster.content_hash())
        self.pacemaker = Pacemaker(chain, deployment.epochs if epochs is None else epochs, self._on_commit)
        turn = turn or (lambda name: None)
        try:
            self._nodes = SingleNodes(deployment, seed, self.pacemaker, output, schedule, watch, record, acts, turn)
        except BaseException:
            self._close_log()
            raise

    def epochs(self) -> Iterator[tuple[int, bytes]]:
        """Go on; gives each epoch's number and digest once it is committed, when the next one may have begun.

        Raises `HieraxError` if a node failed, or a change is refused."""
        count = len(self._nodes.runners)
        if count > MANY:
            into_large_pages()
        with _rarely_collecting(count):
            for _ in self._nodes.turns():
                while self._told:
                    yield self._told.popleft()

    def change(self, change: Change, terms: Mapping[str, ProcessTerms]) -> int:
        """Have the roster change as soon as may be, and give the first epoch under it; `terms`: of its new nodes.

        Raises `HieraxError` if it is refused, or the run has no such epoch any more."""
        return self._nodes.ask(change, terms)

    def node_report(self, name: str) -> NodeReport:
        """A node as it is after the last epoch that it has done. Raises `HieraxError` if there is none of this name."""
        nodes = self._nodes.runners
        if name not in nodes:
            raise HieraxError(f"there is no node {name!r}{did_you_mean(name, nodes, 'the nodes are')}")
        return nodes[name].report(None)

    def report(self, broken: bool = False) -> Report:
        """What the run has come to. Raises `Interrupted` with that where it was broken off."""
        chain, pacemaker = self.pacemaker.chain, self.pacemaker
        reports, unreported = self._nodes.reports(chain.epoch if broken else None)
        times = (pacemaker.times.wall_s, pacemaker.times.took_s.numbers().tolist())
        run = (self._deployment.name, "run", self._seed, chain.epoch, chain.digest.hex())
        report = Report(*run, *times, reports, self._output)
        if broken:
            raise Interrupted(report, unreported)
        return report

    def close(self) -> None:
        self._nodes.close()
        self._close_log()

    def _close_log(self) -> None:
        if self._digests is not None:
            self._digests.close()

    def _on_commit(self, epoch: int, digest: bytes) -> None:
        if self._digests is not None:
            self._digests.write(epoch, digest)
        if self._record is not None:
            self._record.committed(epoch, digest)
        if self._progress is not None:
            self._progress(epoch, digest)
        self._told.append((epoch, digest))


@contextmanager
def _rarely_collecting(nodes: int) -> Iterator[None]:
    """Have the search for cycles in memory wait longer where there are many nodes.

    It goes through all objects that there are whenever a quarter as many were made, and an epoch makes some dozens a
    node, which the next one gives back: each of ten thousand nodes would pay for it as much as for the epoch."""
    before = gc.get_threshold()
    gc.set_threshold(max(before[0], MADE_A_NODE * nodes) if before[0] else 0, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
