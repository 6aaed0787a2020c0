"""A node's checkpoints: its states at the start and at the end of the last epoch, in two slots."""

import logging
from collections.abc import Sequence

from hierax.runtime.core.binding import BoundNode
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Saved
from hierax.runtime.recovery.disk import SLOTS
from hierax.runtime.recovery.slots import Read, Slots
from hierax.schemas.checkpoint import Checkpoint, decode_checkpoint, decode_state, encode_checkpoint

FIRST_SLOT = 1  # where the first record goes

_log = logging.getLogger("hierax")


class Checkpoints:
    """What a process writes down, and one that comes in its place reads."""

    def __init__(self, slots: Slots) -> None:
        self._slots = slots  # where they are
        self.newest: Checkpoint | None = None  # of those that were written or read

    def save(self, checkpoint: Checkpoint) -> None:
        """Write one over the older of two. Raises `HieraxError` if the storage failed."""
        self._slots.write(encode_checkpoint(checkpoint))
        self.newest = checkpoint

    def save_first(self, checkpoint: Checkpoint) -> None:
        """Write one to both slots: one that is damaged beside an empty one would count as never whole."""
        for _ in range(SLOTS):
            self.save(checkpoint)

    def read(self) -> tuple[Checkpoint, Saved] | None:
        """What a process in a lost one's place goes on with; None: at the beginning. Raises `HieraxError`."""
        reads = self._slots.read()
        data, faults = newest_whole(reads)
        if data is None:
            if not never_whole(reads):
                raise HieraxError(f"its checkpoint cannot be used: {faults}")
            if faults:
                _log.warning("checkpoint: %s; no other was ever written, so the node begins anew", faults)
            return None
        checkpoint = self.newest = decode_checkpoint(data)
        if faults:
            _log.warning("checkpoint: %s; using that of epoch %d", faults, checkpoint.epoch)
        start, now = (ActiveNode(*decode_state(state)) for state in (checkpoint.start, checkpoint.now))
        return checkpoint, Saved(checkpoint.epoch, checkpoint.attempt, start, now, checkpoint.under_way)


def newest_whole(reads: Sequence[Read]) -> tuple[bytes | None, str]:
    """The newest record that is whole, if there is one, and what is wrong with the slots."""
    faults = "; ".join(f"slot {read.slot} {read.fault}" for read in reads if read.fault)
    return next((read.data for read in reads if read.data is not None), None), faults


def never_whole(reads: Sequence[Read]) -> bool:
    """Whether no record was ever written to its end: at most the first one, and that was torn."""
    return all(read.empty or (read.fault and read.slot == FIRST_SLOT) for read in reads)


def taken_over(node: BoundNode, state: bytes) -> ActiveNode:
    """The state with which a node goes on in another's place. Raises `HieraxError` or `SchemaError` if it cannot."""
    belief, policy, actions = decode_state(state)
    try:
        belief = node.node.take_over(belief)
    except Exception as error:
        raise HieraxError(str(error)) from error
    except SystemExit as error:  # it would end the process
        raise HieraxError(f"its take_over exits: {error}") from error
    if policy not in node.policies:
        raise HieraxError(f"it has no policy {policy!r}")
    return ActiveNode(belief, policy, actions)
