"""How old the inputs from above may be."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Staleness:
    """How old inputs from above may be."""

    epochs: int | None = 0  # n; 0 is the barrier; None: free running

    @property
    def barrier(self) -> bool:
        """Whether every input is of the epoch itself."""
        return self.epochs == 0

    @property
    def free(self) -> bool:
        """Whether nodes run freely."""
        return self.epochs is None

    def has_rate(self, *, is_world: bool) -> bool:
        """Whether a node can have a rate of its own: each in free running, the world also with the barrier."""
        return self.free or (self.barrier and is_world)


BARRIER = Staleness()
