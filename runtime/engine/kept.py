"""What has come from neighbours of a node with rates, for as long as it may count."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from hierax.runtime.engine.wiring import Slot
from hierax.schemas.messages import Message


class KeptMessages(defaultdict[Slot, dict[int, Message]]):
    """Messages by sender and kind, and there by epoch.

    What is asked for again with every message that comes goes on where it stopped: what was there stays there until it
    is taken, or other slots count."""

    def __init__(self) -> None:
        super().__init__(dict)
        self._missing: list[tuple[Slot, int]] = []  # of what counts, what may not have come yet
        self._incomplete: dict[int, list[Slot]] = {}  # likewise of all slots, by epoch

    def has_all(self, slots: Iterable[Slot], epoch: int) -> bool:
        """Whether messages of an epoch have come of all slots."""
        missing = self._incomplete.get(epoch)
        if missing is None:
            missing = self._incomplete[epoch] = list(slots)
        while missing and epoch in self[missing[-1]]:
            missing.pop()
        return not missing

    def count(self, counting: Mapping[Slot, int]) -> None:
        """From now on these count: by slot, of which epoch; 0: of none yet."""
        self._missing = [(slot, epoch) for slot, epoch in counting.items() if epoch]

    def lacks(self) -> bool:
        """Whether something of what counts has not come."""
        missing = self._missing
        while missing and missing[-1][1] in self[missing[-1][0]]:
            missing.pop()
        return bool(missing)

    def lacking(self, counting: Mapping[Slot, int]) -> list[Slot]:
        """Of which slots what counts has not come: by slot, the epoch that counts; 0: nothing does yet."""
        return [slot for slot, epoch in counting.items() if epoch and epoch not in self[slot]]

    def only(self, since: Mapping[Slot, int]) -> None:
        """Nothing is kept of other slots, nor what is of an epoch before these."""
        for slot in [slot for slot in self if slot not in since]:
            del self[slot]
        for slot, epoch in since.items():
            drop_before(self[slot], epoch)
        self._incomplete.clear()

    def taken(self, slots: Iterable[Slot], epoch: int) -> dict[Slot, Message]:
        """What counts in this epoch alone; nothing of those before it counts any more."""
        drop_before(self._incomplete, epoch + 1)
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
