"""What the roster's owner calls."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

from hierax.schemas.control import Order

RESTART, DETACH, STOP = "restart", "detach", "stop"  # what follows when a node does not come back


@dataclass(frozen=True)
class OwnerPolicy:
    """What the deployment says."""

    modules: tuple[str, ...] = ()  # from which code may be loaded
    on_loss: Mapping[str, str] = field(default_factory=dict)  # by node; `RESTART` where it says nothing
    rejoin_timeout_s: Mapping[str, float] = field(default_factory=dict)  # how long a lost node may take to return
    alone: tuple[str, ...] = ()  # the nodes that are detached when an operator or edge function of theirs raises
    epoch_deadline_s: float | None = None  # how long an epoch may take before it is asked who waits; None: for ever
    start_timeout_s: float = 30.0  # how long a new node's process may take to come up
    answer_timeout_s: float = 5.0  # how long a process may take to answer the owner
    rated: bool = False  # whether nodes have rates, so that one may not have begun when others have done epochs
    overlaps: bool = False  # whether epochs overlap (a staleness, rates): the roster changes after a drained epoch


class OwnerEffects(ABC):
    """The other side of an owner. What it is asked to send may be lost: the owner asks again."""

    @abstractmethod
    def send_order(self, process: str, order: Order) -> None:
        """Send an order to a process; the owner's own is one of them."""

    @abstractmethod
    def write_record(self) -> None:
        """Write the world's record, with the owner's highest version, before anything else goes out."""

    @abstractmethod
    def begin(self, epoch: int, attempt: int, version: int) -> None:
        """Have the world begin an epoch, or begin it again, under a version of the roster; its record first."""

    @abstractmethod
    def answer(self, request: str, epoch: int, refusal: str) -> None:
        """Tell whoever asked for a change the first epoch under it, committed by now; or why there is none."""

    @abstractmethod
    def end(self, name: str, process: str, why: str) -> None:
        """Have its supervisor kill a process that hangs, and treat it as lost."""

    @abstractmethod
    def stop(self, why: str) -> None:
        """The run cannot go on."""

    @abstractmethod
    def note(self, what: str) -> None:
        """Tell people what happens."""
