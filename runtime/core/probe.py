"""Probes: they see what a node did in each epoch and write it somewhere; the run never depends on them."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple

from hierax.runtime.core.elements import Elements, Value


class Step(NamedTuple):
    """One epoch of one node.

    Attributes:
        epoch: counts from 1.
        attempt: which attempt of the epoch this was.
        time_s: the epoch's time in seconds.
        observations: O, what `observe` was given (empty for the world).
        sensed: s after `observe`.
        tasks, context: T and C, what came from above.
        policy, actions: π and a.
        belief: s after `predict`.
    """

    epoch: int
    attempt: int
    time_s: float
    observations: Elements
    sensed: Value
    tasks: Elements
    context: Elements
    policy: str
    actions: Elements
    belief: Value


class Probe(ABC):
    """Watches one node, in the node's process. Named in the deployment file under ``probes``.

    Attributes:
        prompt: whether it is told of an epoch before the node's checkpoint is written and its context sent. What it
            writes lacks no epoch then, wherever the process dies; but the other nodes wait for it.
        overwrite: whether `open` may write over what another run has left (`--overwrite`); set before it is called.
    """

    prompt: bool = False
    overwrite: bool = False

    def open(self, output: Path | None) -> None:
        """Called once before the first epoch.

        Args:
            output: the run's output folder, which exists; None where none was asked for.
        """
        return

    def open_again(self, output: Path | None) -> None:
        """Called in place of `open` where a process of the node comes in the place of one that died.

        What is in the folder was written in this run, and the last epochs may be told again (with a later attempt). By
        default what `open` does, which suits what writes one file for each epoch."""
        self.open(output)

    @abstractmethod
    def record(self, step: Step) -> None:
        """Called after each epoch, when the node's messages are sent, or before if it is prompt.

        Nothing in `step` may be changed. Epochs may be told again, with a later attempt; a prompt probe may be
        told of one that is never committed."""

    def close(self) -> None:
        """Called once after the last epoch."""
        return
