"""What has come from neighbours of a node with rates, for as long as it may count."""

from collections import defaultdict
from collections.abc import Iterable, Mapping

from hierax.runtime.engine.wiring import Slot
from hierax.schemas.messages import Message


class KeptMessages:
    """Messages by sender and kind, and there by epoch."""

    def __init__(self) -> None:
        self._slots: defaultdict[Slot, dict[int, Message]] = defaultdict(dict)

    def has(self, slot: Slot, epoch: int) -> bool:
        return epoch in self._slots[slot]

    def has_all(self, slots: Iterable[Slot], epoch: int) -> bool:
        for slot in slots:  # noqa: SIM110 - a loop takes half the time of all()
            if epoch not in self._slots[slot]:
                return False
        return True

    def of(self, slot: Slot, epoch: int) -> Message | None:
        return self._slots[slot].get(epoch)

    def keep(self, slot: Slot, message: Message) -> None:
        self._slots[slot][message.header.epoch] = message

    def forget(self, slot: Slot, before: int) -> None:
        """Those of the epochs before this one count no more."""
        _forget(self._slots[slot], before)

    def only(self, since: Mapping[Slot, int]) -> None:
        """Nothing is kept of other slots, nor what is of an epoch before these."""
        for slot in [slot for slot in self._slots if slot not in since]:
            del self._slots[slot]
        for slot, epoch in since.items():
            self.forget(slot, epoch)

    def take(self, slot: Slot, epoch: int) -> Message:
        """What counts in this epoch alone; nothing of those before it counts any more."""
        kept = self._slots[slot]
        message = kept.pop(epoch)
        if kept:
            _forget(kept, epoch)
        return message


def _forget(kept: dict[int, Message], before: int) -> None:
    for epoch in [epoch for epoch in kept if epoch < before]:
        del kept[epoch]
