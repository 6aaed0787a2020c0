"""Who records a launch: processes that come into the run meanwhile wait until they are heard."""

import time
from collections.abc import Callable
from math import inf

COMES_S = 30.0  # how long who says that it is about to record may take to listen


class Recorders:
    """Those who record a run, or are about to, as far as their sessions tell; which ones they are is no matter."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._are_heard_of = False
        self._until_s = -inf

    def expect(self) -> None:
        """Somebody is about to record."""
        self._until_s = self._clock() + COMES_S

    def hear_of(self, somebody: bool) -> None:
        """Whether somebody listens to the run has changed; who was expected is taken to have come."""
        self._are_heard_of = somebody
        self._until_s = -inf

    @property
    def are_there(self) -> bool:
        return self._are_heard_of or self._clock() < self._until_s
