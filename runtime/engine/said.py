"""What a node has said to its neighbours, for as long as one of them may lack it."""

from collections.abc import Iterable

from hierax.runtime.engine.wiring import Slot
from hierax.schemas.messages import Message, encode_message


class SaidMessages:
    """Messages by receiver and kind, and there by epoch; one is encoded when the bytes of all are asked for, once."""

    def __init__(self, messages: Iterable[Message] = ()) -> None:
        self._messages: dict[Slot, dict[int, Message]] = {}
        self._bytes: dict[tuple[Slot, int], bytes] = {}
        for message in messages:
            self.keep(message)

    def keep(self, message: Message) -> None:
        """One more. Where it is there of that epoch, as the node has come back and does it again, it says the same."""
        header = message.header
        self._messages.setdefault((header.receiver, header.kind), {})[header.epoch] = message

    def forget(self, receiver: str, kind: str, before: int) -> None:
        """A neighbour will not ask any more for those of the epochs before this one."""
        slot = (receiver, kind)
        kept = self._messages.get(slot, {})
        for epoch in [epoch for epoch in kept if epoch < before]:
            del kept[epoch]
            self._bytes.pop((slot, epoch), None)

    def to(self, receiver: str) -> list[Message]:
        """All that a neighbour may lack, in the order of epochs."""
        found = [each for slot, kept in self._messages.items() if slot[0] == receiver for each in kept.values()]
        return sorted(found, key=lambda message: message.header.epoch)

    def encoded(self) -> tuple[bytes, ...]:
        """All that any of them may lack."""
        return tuple(
            self._encoded(slot, epoch, message)
            for slot, kept in self._messages.items()
            for epoch, message in kept.items()
        )

    def _encoded(self, slot: Slot, epoch: int, message: Message) -> bytes:
        data = self._bytes.get((slot, epoch))
        if data is None:
            data = self._bytes[slot, epoch] = encode_message(message)
        return data
