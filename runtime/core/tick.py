"""What an operator may know beyond its arguments: the tick."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

from numpy.random import Generator, Philox  # by name: `np.random` would be imported in the first epoch that draws


@dataclass(frozen=True)
class Tick:
    """Given to an operator or edge function that has a parameter named ``tick``.

    Attributes:
        seed: the run's seed.
        subject: the node, or the edge as ``lower->upper``.
        operator: which operator or edge function is called.
        epoch: counts from 1; 0 outside of a run.
        time_s: the epoch's time in seconds, as the world set it.
        below, above: names of the neighbours of the node (of an edge function: of the edge's lower and upper node).
    """

    seed: int = 0
    subject: str = ""
    operator: str = ""
    epoch: int = 0
    time_s: float = 0.0
    below: tuple[str, ...] = ()
    above: tuple[str, ...] = ()

    @cached_property
    def rng(self) -> Generator:
        """Random numbers of this call: the same ones when the epoch is done again."""
        key = f"{self.seed}/{self.subject}/{self.operator}/{self.epoch}"
        entropy = hashlib.blake2b(key.encode(), digest_size=16).digest()
        return Generator(Philox(int.from_bytes(entropy, "little")))


NO_TICK = Tick()
"""The default of a ``tick`` parameter, for calls outside of a run."""
