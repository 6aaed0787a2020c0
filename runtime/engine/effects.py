"""What an engine calls: messages to send, states to keep, and events."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.table import Verdict
from hierax.schemas.messages import Header, Message


class Called(NamedTuple):
    """An operator or edge function was called."""

    epoch: int  # when
    attempt: int  # likewise
    subject: str  # the node, or the edge as ``lower->upper``
    operator: str  # which one
    result: Value  # what it returned


class Completed(NamedTuple):
    """The node is done with an epoch."""

    step: Step  # what went in and came out
    state: bytes  # the encoding of (belief, policy, actions)
    digest: bytes  # the node's digest of the epoch


class Committed(NamedTuple):
    """The world has acted: the epoch is over for all nodes, and this is its digest."""

    epoch: int
    attempt: int
    digest: bytes


class Saved(NamedTuple):
    """What a node needs in order to go on after a crash."""

    epoch: int  # the last ones that it has finished
    attempt: int  # likewise
    start: ActiveNode  # its state at the epoch's start
    now: ActiveNode  # its state after it
    under_way: bytes = b""  # what `Engine.under_way` was then


class EngineEffects(ABC):
    """The other side of an engine: it is called as soon as something is known, in this order.

    What an implementation raises comes out of `Engine.receive`; the engine is of no use after that."""

    @abstractmethod
    def send(self, message: Message) -> None:
        """A message for the neighbour that its header names."""

    @abstractmethod
    def completed(self, completed: Completed) -> None:
        """The node is done with an epoch, and all its messages are sent."""

    def predicted(self, completed: Completed) -> None:
        """The node is done with an epoch but for what follows: neither its checkpoint nor its context is out yet."""
        return

    def save(self, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        """Keep the states (encoded) at an epoch's start and after it, before anything else goes out.

        Called in every epoch that a node but the world finishes, and before its first one."""
        return

    def act(self, epoch: int, actions: Elements) -> None:
        """Move the actuators, before the epoch is committed. Only the world's engine calls it."""
        return

    def committed(self, committed: Committed) -> None:
        """The epoch is over. Only the world's engine calls it, just before `completed`."""
        return

    def refused(self, header: Header, verdict: Verdict) -> None:
        """A message was refused; it changed nothing."""
        return

    def lacks(self, version: int) -> None:
        """A message of a roster's version came that the node does not have; it is held until `Engine.prepare`."""
        return

    def rewired(self, version: int) -> None:
        """A version of the roster is taken up."""
        return

    def called(self, called: Called) -> None:
        """An operator or edge function was called; told only where the engine's `events` is set."""
        return
