"""What somebody else on the network makes of a message, in the name of its sender: pure functions.

Forged messages come after the one that they are made of, as nobody can tell which of two was the sender's.
"""

from __future__ import annotations

from hierax.runtime.engine.table import ATTEMPTS_AHEAD, EPOCHS_AHEAD, ROSTERS_AHEAD
from hierax.runtime.sim.inspection import tagged_as_of
from hierax.runtime.sim.scenario import CONTRADICT, FORETELL
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Message


def forged(kind: str, message: Message) -> list[Message]:
    """All messages of a kind that can be made of one; what is foretold is what will be said, and something else."""
    header = message.header
    if kind == FORETELL:
        attempt = header.attempt + 1
        said = tagged_as_of(message.payload, header.epoch, attempt)
        return [Message(header._replace(attempt=attempt), payload) for payload in (said, (*said, "forged"))]
    if kind == CONTRADICT:
        headers = [header]
    elif header.kind == OBSERVATIONS:
        headers = [
            header._replace(sender="stranger"),
            header._replace(roster=header.roster + ROSTERS_AHEAD + 10),
            header._replace(epoch=header.epoch + EPOCHS_AHEAD + 10),
            header._replace(attempt=header.attempt + ATTEMPTS_AHEAD + 10),
        ]
    else:
        headers = [
            header._replace(receiver="stranger"),
            header._replace(roster=header.roster + ROSTERS_AHEAD + 10),
            header._replace(instance=header.instance + 1000),
            header._replace(kind=CONTEXT, attempt=header.attempt + 1, digest=b""),
        ]
    return [Message(each, (*message.payload, "forged")) for each in headers]
