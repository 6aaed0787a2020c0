"""What an engine gives back: messages to send, and events."""

from __future__ import annotations

from hashlib import blake2b
from typing import NamedTuple

from hierax.runtime.core.node import Value
from hierax.runtime.core.probe import Step
from hierax.runtime.engine.table import Verdict
from hierax.schemas.messages import DIGEST_BYTES, Header, Message
from hierax.schemas.values import encode_value


class Send(NamedTuple):
    """A message for one neighbour: its header says whom."""

    message: Message


class Called(NamedTuple):
    """An operator or edge function was called.

    Attributes:
        epoch, attempt: when.
        subject: the node, or the edge as ``lower->upper``.
        operator: which one.
        result: what it returned.
    """

    epoch: int
    attempt: int
    subject: str
    operator: str
    result: Value

    @property
    def hash(self) -> bytes:
        """BLAKE2b-256 over the result's encoding; taken when asked for, as it costs more than the event."""
        return blake2b(encode_value(self.result), digest_size=DIGEST_BYTES).digest()


class Completed(NamedTuple):
    """The node is done with an epoch.

    Attributes:
        step: what went in and came out.
        state: the encoding of (belief, policy, actions).
        digest: the node's digest of the epoch.
    """

    step: Step
    state: bytes
    digest: bytes


class Committed(NamedTuple):
    """The world has acted: the epoch is over for all nodes, and this is its digest."""

    epoch: int
    attempt: int
    digest: bytes


class Refused(NamedTuple):
    """A message was refused; it changed nothing."""

    header: Header
    verdict: Verdict


Output = Send | Called | Completed | Committed | Refused
