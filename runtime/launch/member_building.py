"""What a node's process has from its first instant on: what it names is open, and what it needs imported."""

import importlib
import logging
import os
from collections.abc import Callable
from mmap import mmap
from pathlib import Path

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.engine.engine import Engine
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.output_folder import digest_log, open_probes, state_log
from hierax.runtime.execution.pace import Pace
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.times import TIMES_BYTES, Times
from hierax.runtime.host.private_files import errors_named, open_private, private_folder
from hierax.runtime.launch.frames import BEGIN, DIGESTS, STATES, NodeOrder, SupervisorPipe
from hierax.runtime.launch.kept_elsewhere import KeptElsewhere, ToldLog
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.watch.budget import BUDGET_BYTES, Budget
from hierax.runtime.watch.overruns import OVERRUNS_BYTES, Overruns

_log = logging.getLogger("hierax")


def open_observers(order: NodeOrder, pipe: SupervisorPipe) -> Observers:
    """The state log and the probes that an order names, open. Raises `HieraxError` if one cannot be opened."""
    output, again = order.output_path, order.life != BEGIN
    probes = open_probes(order.probes, order.name, order.allowance, output, again)
    states = ToldLog(pipe, STATES) if order.states else state_log(output, order.name, again)
    return Observers(order.name, probes, states)


def open_slots(order: NodeOrder, kept: KeptElsewhere | None) -> Slots:
    """Where the node's checkpoints are, or the world's record; `kept`: with the supervisor, on another host. Raises
    `HieraxError` if the file cannot be opened."""
    return Slots(kept or MappedFile(Path(order.checkpoint), order.durability))


def pacemaker_of(order: NodeOrder, publish: Callable[[int, bytes], None], pipe: SupervisorPipe) -> Pacemaker:
    """The world's, which publishes the digests of its epochs, and writes them where that is wanted."""
    roster_hash = b"" if order.roster is None else order.roster.content_hash()
    log = ToldLog(pipe, DIGESTS) if order.states else digest_log(order.output_path, append=order.life != BEGIN)

    def on_commit(epoch: int, digest: bytes) -> None:
        publish(epoch, digest)
        if log is not None:
            log.write(epoch, digest)
            log.flush()

    is_paced = order.rate_hz is not None and order.staleness == 0  # in free running it takes turns
    times = open_times(order)
    pace = Pace(order.rate_hz, order.late, times) if is_paced and order.rate_hz else None
    return Pacemaker(DigestChain(roster_hash), order.epochs, on_commit, pace=pace, times=times)


def open_times(order: NodeOrder) -> Times:
    """The run's, beside the world's record. Raises `HieraxError` if the file cannot be opened."""
    return Times(_memory(order, Path(f"{order.checkpoint}.times"), TIMES_BYTES), int(order.run, 16))


def open_budget(order: NodeOrder, engine: Callable[[], Engine | None]) -> Budget | None:
    """The node's, whose counts go on with whatever process or class comes in its place; None: it has none. Raises
    `HieraxError` if the file cannot be opened."""
    if order.budget_ms is None and order.period_ms is None:
        return None
    memory = _memory(order, _beside(order, "budget"), BUDGET_BYTES)
    return Budget(order.budget_ms, order.period_ms, engine, memory)


def open_overruns(order: NodeOrder, engine: Callable[[], Engine | None]) -> Overruns | None:
    """Likewise of the node's waiting for those above it; None: nobody has rates."""
    if not order.rated:
        return None
    memory = _memory(order, _beside(order, "overruns"), OVERRUNS_BYTES)
    return Overruns(engine, order.life != BEGIN, order.period_ms, memory)


def _beside(order: NodeOrder, what: str) -> Path:
    """A file beside the checkpoints that is the node's whichever process or class it has."""
    return Path(order.checkpoint).parent / f"{order.name}.{what}"


def _memory(order: NodeOrder, path: Path, size: int) -> mmap:
    """A file beside the checkpoints, of zeros where the run begins; on another host than they are, memory of this
    process alone."""
    if order.slots is not None:
        return mmap(-1, size)
    with errors_named(path, "opened"), private_folder(path.parent) as folder:
        file = open_private(folder, path.name, os.O_RDWR | os.O_CREAT, path)
        try:
            if order.life == BEGIN:
                os.truncate(file, 0)
            os.posix_fallocate(file, 0, size)
            return mmap(file, size)
        finally:
            os.close(file)


def preload(modules: tuple[str, ...], allowance: Allowance) -> None:
    """Import what will be needed; what fails, or may not be loaded, is told when it is."""
    for module in filter(allowance.covers, modules):
        try:
            importlib.import_module(module)
        except Exception as error:  # noqa: PERF203 - each for itself
            _log.info("%s cannot be imported yet: %s", module, error)
