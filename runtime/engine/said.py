"""What a node has said to its neighbours, for as long as one of them may lack it."""

from collections import defaultdict
from collections.abc import Iterable, Mapping

from hierax.runtime.core.digest import elements_cannot_travel
from hierax.runtime.engine.kept import drop_before
from hierax.runtime.engine.wiring import Slot
from hierax.schemas.checkpoint import Forgotten
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Message, SaidMessage


class SaidMessages:
    """Messages by receiver and kind, and there by epoch; one is encoded when the bytes of all are asked for, once."""

    def __init__(self, messages: Iterable[Message] = (), forgotten: Iterable[Forgotten] = ()) -> None:
        self._messages: defaultdict[Slot, dict[int, SaidMessage]] = defaultdict(dict)
        self._forgotten: dict[Slot, Forgotten] = {(each[0], each[1]): each for each in forgotten}
        for message in messages:
            self.keep(message)

    def keep(self, message: Message) -> SaidMessage:
        """One more, to be sent. Where it is there of that epoch, as the node has come back and does it again, it says
        the same."""
        header = message.header
        kept = tuple.__new__(SaidMessage, message)  # the named tuple's own constructor takes thrice as long
        self._messages[header.receiver, header.kind][header.epoch] = kept
        return kept

    def forget(self, receiver: str, kind: str, before: int, instance: int) -> None:
        """A neighbour, of this instance, will not ask any more for those of the epochs before this one."""
        slot = (receiver, kind)
        known = self._forgotten.get(slot)
        if known is None or known[2] < before or (known[2] == before and known[3] < instance):
            self._forgotten[slot] = (receiver, kind, before, instance)
        drop_before(self._messages[slot], before)

    def only(self, since: Mapping[str, int]) -> None:
        """What was said to these, from an epoch on; nothing was forgotten of who came later than the run began."""
        for slot in {*self._messages, *self._forgotten}:
            receiver = slot[0]
            first = since.get(receiver)
            if first is None:
                self._messages.pop(slot, None)
            else:
                drop_before(self._messages[slot], first)
            if slot in self._forgotten and (first is None or self._forgotten[slot][2] < first):
                del self._forgotten[slot]

    def has_from(self, receiver: str, kind: str, epoch: int, instance: int) -> bool:
        """Whether nothing is forgotten of what was said in an epoch, or later; what the same instance has let be
        forgotten, it had."""
        _, _, before, had_by = self._forgotten.get((receiver, kind), (receiver, kind, 0, instance))
        return before <= epoch or had_by == instance

    def to(self, receiver: str) -> list[Message]:
        """All that a neighbour may lack, in the order of epochs."""
        found = [each for slot, kept in self._messages.items() if slot[0] == receiver for each in kept.values()]
        return sorted(found, key=lambda message: message.header.epoch)

    def encoded(self) -> tuple[bytes, ...]:
        """All that any of them may lack. Raises `OperatorError` if there is something that cannot travel."""
        messages = [message for kept in self._messages.values() for message in kept.values()]
        return tuple([message.data or _encoded(message) for message in messages])

    @property
    def forgotten(self) -> tuple[Forgotten, ...]:
        """What neighbours do not ask for any more."""
        return tuple(self._forgotten.values())


def _encoded(message: SaidMessage) -> bytes:
    try:
        return message.keep_encoded()
    except SchemaError as error:
        kind, sender, receiver, epoch = message.header[:4]
        raise elements_cannot_travel(kind, sender, receiver, epoch, error) from error
