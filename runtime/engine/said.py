"""What a node has said to its neighbours, for as long as one of them may lack it."""

from collections.abc import Iterable, Mapping

from hierax.runtime.engine.wiring import Slot
from hierax.schemas.checkpoint import Forgotten
from hierax.schemas.messages import Message, encode_message


class SaidMessages:
    """Messages by receiver and kind, and there by epoch; one is encoded when the bytes of all are asked for, once."""

    def __init__(self, messages: Iterable[Message] = (), forgotten: Iterable[Forgotten] = ()) -> None:
        self._messages: dict[Slot, dict[int, Message]] = {}
        self._bytes: dict[tuple[Slot, int], bytes] = {}
        self._forgotten = {(receiver, kind): (before, by) for receiver, kind, before, by in forgotten}
        for message in messages:
            self.keep(message)

    def keep(self, message: Message) -> None:
        """One more. Where it is there of that epoch, as the node has come back and does it again, it says the same."""
        header = message.header
        self._messages.setdefault((header.receiver, header.kind), {})[header.epoch] = message

    def forget(self, receiver: str, kind: str, before: int, instance: int) -> None:
        """A neighbour, of this instance, will not ask any more for those of the epochs before this one."""
        slot = (receiver, kind)
        kept, known = self._messages.get(slot, {}), self._forgotten.get(slot)
        if known is None or known < (before, instance):
            self._forgotten[slot] = (before, instance)
        for epoch in [epoch for epoch in kept if epoch < before]:
            del kept[epoch]
            self._bytes.pop((slot, epoch), None)

    def only(self, since: Mapping[str, int]) -> None:
        """What was said to these, from an epoch on; nothing was forgotten of who came later than the run began."""
        for slot in {*self._messages, *self._forgotten}:
            receiver = slot[0]
            first = since.get(receiver)
            kept = self._messages.get(slot, {})
            for epoch in [epoch for epoch in kept if first is None or epoch < first]:
                del kept[epoch]
                self._bytes.pop((slot, epoch), None)
            if first is None or self._forgotten.get(slot, (0, 0))[0] < first:
                self._forgotten.pop(slot, None)

    def has_from(self, receiver: str, kind: str, epoch: int, instance: int) -> bool:
        """Whether nothing is forgotten of what was said in an epoch, or later; what the same instance has let be
        forgotten, it had."""
        before, had_by = self._forgotten.get((receiver, kind), (0, instance))
        return before <= epoch or had_by == instance

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

    @property
    def forgotten(self) -> tuple[Forgotten, ...]:
        """What neighbours do not ask for any more."""
        return tuple((*slot, *known) for slot, known in self._forgotten.items())

    def _encoded(self, slot: Slot, epoch: int, message: Message) -> bytes:
        data = self._bytes.get((slot, epoch))
        if data is None:
            data = self._bytes[slot, epoch] = encode_message(message)
        return data
