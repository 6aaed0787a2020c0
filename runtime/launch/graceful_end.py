"""The graceful end of a launch that a signal breaks off: what was committed until then is reported.

The world is asked to end with the epoch under way. Where that does not come to its end in time, it is given up. Then
the world says which epoch was the last one, and every node what it was after it. Who does not answer is killed, and
its checkpoint speaks for it.
"""

from pathlib import Path

import anyio
import numpy as np

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.deployment import Deployment
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.output_folder import digest_log
from hierax.runtime.execution.world_member import read_record
from hierax.runtime.launch.child import Child
from hierax.runtime.launch.frames import FINISH, LEAVE, NodeOrder
from hierax.runtime.launch.process_supervisor import Notify
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.runtime.recovery.disk import MappedFile, kept_at
from hierax.runtime.recovery.slots import Slots
from hierax.schemas.errors import SchemaError

EPOCH_S = 0.7  # how long the epoch under way may take to come to its end
ANSWER_S = 0.15  # how long the world's process, and then all others, may take to tell what they have come to
KILLED_S = 5.0  # how long one that was killed may take to be gone: until then it holds its checkpoint
CLOSE_S = 0.35  # how long who has told may take to close probes and files, and to end

_ASK_AGAIN_S = 0.1
_POLL_S = 0.005


class GracefulEnd:
    """Ends the run of a launch. `deployment`: that is launched."""

    def __init__(self, processes: RosterSupervisor, deployment: Deployment, notify: Notify) -> None:
        self._processes = processes  # those of the launch
        self._world = deployment.roster.world
        self._barrier = deployment.staleness.barrier
        self._overlaps = deployment.overlaps
        self._notify = notify  # tells people what happens
        self.epoch: int | None = None  # the last one committed; None: it is not known
        self.unreported: dict[str, str] = {}  # nodes whose state after it is not known, and why

    async def finish_epoch(self) -> None:
        """Have the epoch under way be the last one, and wait for its end; not for long."""
        with anyio.move_on_after(EPOCH_S):
            while not self._processes.finished.is_set():
                await self._processes.current[self._world].send(FINISH)  # another process, if it has just died
                with anyio.move_on_after(_ASK_AGAIN_S):
                    await self._processes.finished.wait()

    async def collect(self) -> None:
        """Have every process tell what it was after the last epoch, and end those that don't."""
        self._processes.ending = True
        worlds = [child for child in self._processes.present if child.name == self._world]
        await self._ask(worlds, None)
        for child in worlds:
            if child.report is None:
                self._recall_world(child)
            if child.report is not None:
                self.epoch = int(child.report["run"][0])
        await self._ask([child for child in self._processes.present if child.name != self._world], self.epoch)

    def recall(self) -> None:
        """Take from their checkpoints what processes did not tell; they have ended."""
        for child in self._processes.present:
            if child.report is not None or self.epoch is None:
                continue
            try:
                child.report = {**self._read(child.order, self.epoch)._asdict(), "metrics": {}}
            except (HieraxError, SchemaError) as error:
                self.unreported[child.name] = str(error)
            else:
                self._notify(
                    f"{child.name}: its process did not answer; its checkpoint tells its state, and no metrics"
                )

    async def _ask(self, children: list[Child], epoch: int | None) -> None:
        for child in children:
            await child.send({LEAVE: epoch})
        with anyio.move_on_after(ANSWER_S):
            while any(child.report is None and not child.ended.is_set() for child in children):
                await anyio.sleep(_POLL_S)
        for child in children:
            if child.report is None:
                child.kill()
        with anyio.move_on_after(KILLED_S):
            for child in children:
                if child.report is None:
                    await child.ended.wait()

    def _recall_world(self, child: Child) -> None:
        try:
            with _slots(child.order) as storage:
                record, saved = read_record(Slots(storage))
            log = digest_log(child.order.output_path, append=True) if record.epoch > 1 else None
            if log is not None:  # as a next process of the world's would: this one may have ended before
                log.write(record.epoch - 1, record.last_digest)
                log.close()
        except (HieraxError, SchemaError) as error:
            self.unreported[child.name] = str(error)
            return
        run = [record.epoch - 1, record.last_digest, 0.0, np.zeros(0)]
        child.report = {**saved.now._asdict(), "metrics": {}, "run": run}

    def _read(self, order: NodeOrder, epoch: int) -> ActiveNode:
        """What a node was after an epoch. Raises `HieraxError` or `SchemaError` if its checkpoint does not tell."""
        with _slots(order) as storage:
            found = Checkpoints(Slots(storage)).read()
        if found is None:
            raise HieraxError("its process did not answer, and has kept no checkpoint yet")
        checkpoint, saved = found
        if not self._overlaps and checkpoint.epoch - epoch not in (0, 1):
            raise HieraxError(f"its process did not answer, and its checkpoint is of epoch {checkpoint.epoch}")
        return saved.start if self._barrier and checkpoint.epoch > epoch else saved.now


def _slots(order: NodeOrder) -> MappedFile:
    storage = kept_at(Path(order.checkpoint), order.durability)
    if storage is None:
        raise HieraxError("its process did not answer, and has kept no checkpoint yet")
    return storage
