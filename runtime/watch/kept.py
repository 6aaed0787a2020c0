"""Numbers in a piece of memory that may outlive the process: the last ones of them, and how many there were."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Cells: TypeAlias = "memoryview[float]"

TOLD = 1024  # how many epochs, the last ones, are told by their numbers


class Kept:
    """The last ones of some numbers, and how many there were."""

    def __init__(self, cells: Cells, count: int, first: int, most: int) -> None:
        self._cells, self._count, self._first, self._most = cells, count, first, most

    def append(self, number: float) -> None:
        count = self._cells[self._count]
        self._cells[self._first + int(count) % self._most] = number
        self._cells[self._count] = count + 1.0

    @property
    def count(self) -> int:
        """How many there were."""
        return int(self._cells[self._count])

    @property
    def last(self) -> float:
        return float(self._cells[self._first + (self.count - 1) % self._most]) if self.count else 0.0

    def numbers(self) -> NDArray[np.float64]:
        """The last ones, in order."""
        held = np.array(self._cells[self._first : self._first + min(self.count, self._most)])
        return np.roll(held, -(self.count % self._most)) if self.count > self._most else held
