"""What has come from neighbours of a node with rates, for as long as it may count."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from hierax.runtime.engine.wiring import Slot
from hierax.schemas.messages import Message


class KeptMessages(defaultdict[Slot, dict[int, Message]]):
    """Messages by sender and kind, and there by epoch."""

    def __init__(self) -> None:
        super().__init__(dict)

    def has_all(self, slots: Iterable[Slot], epoch: int) -> bool:
        for slot in slots:  # noqa: SIM110 - a loop takes half the time of all()
            if epoch not in self[slot]:
                return False
        return True

    def lacks(self, counting: Mapping[Slot, int]) -> bool:
        """Whether something is `lacking`."""
        for slot, epoch in counting.items():  # noqa: SIM110 - as above
            if epoch and epoch not in self[slot]:
                return True
        return False

    def lacking(self, counting: Mapping[Slot, int]) -> list[Slot]:
        """Of which slots what counts has not come: by slot, the epoch that counts; 0: nothing does yet."""
        return [slot for slot, epoch in counting.items() if epoch and epoch not in self[slot]]

    def only(self, since: Mapping[Slot, int]) -> None:
        """Nothing is kept of other slots, nor what is of an epoch before these."""
        for slot in [slot for slot in self if slot not in since]:
            del self[slot]
        for slot, epoch in since.items():
            drop_before(self[slot], epoch)

    def taken(self, slots: Iterable[Slot], epoch: int) -> dict[Slot, Message]:
        """What counts in this epoch alone; nothing of those before it counts any more."""
        taken = {}
        for slot in slots:
            kept = self[slot]
            taken[slot] = kept.pop(epoch)
            if kept:
                drop_before(kept, epoch)
        return taken


def drop_before(messages: dict[int, Any], before: int) -> None:
    """Of messages by epoch those of the epochs before this one."""
    for epoch in tuple(messages):
        if epoch < before:
            del messages[epoch]
