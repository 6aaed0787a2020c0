from __future__ import annotations

from hierax.runtime.watch.copier import Copier
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Header, Message, decode_message


def test_only_what_is_wanted_is_shown() -> None:
    shown: list[tuple[str, str, str, bytes]] = []
    copier = Copier(lambda *what: shown.append(what))
    up = Message(Header(OBSERVATIONS, "arm", "top", 3), (1.5,))
    copier.sent(up)
    assert shown == []
    copier.wanted = {(OBSERVATIONS, "arm", "top")}
    copier.sent(up)
    copier.sent(Message(Header(CONTEXT, "arm", "low", 3), ()))
    ((kind, sender, receiver, data),) = shown
    assert (kind, sender, receiver) == (OBSERVATIONS, "arm", "top")
    assert decode_message(data) == up
