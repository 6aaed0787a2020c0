"""Processes get new certificates one after the other; one that ends meanwhile gets none."""

from __future__ import annotations

import anyio
import pytest

from hierax.runtime.launch import renewal
from hierax.runtime.launch.renewal import renew, renew_again_and_again


class Process:
    """Shows another certificate at once, or never; `ends` has ended by then."""

    def __init__(self, name: str, shows: bool = True, ends: Process | None = None) -> None:
        self.name, self.renewals, self.is_up = name, 0, True
        self._shows, self._ends = shows, ends

    def renewed_secret(self) -> str:
        assert self.is_up, "what has ended is made no certificate"
        return f"for {self.name}"

    async def renew(self, secret: str) -> None:
        assert secret == f"for {self.name}"
        self.renewals += self._shows
        if self._ends is not None:
            self._ends.is_up = False


def test_one_that_ends_while_others_have_their_turn_gets_none() -> None:
    last = Process("last")
    first = Process("first", ends=last)
    told: list[str] = []

    async def turns() -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(renew_again_and_again, lambda: [first, last], 0.03, told.append)
            while first.renewals < 3:
                await anyio.sleep(0)
            tasks.cancel_scope.cancel()

    anyio.run(turns)
    assert (last.renewals, told) == (0, [])


def test_one_that_shows_none_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renewal, "RENEWS_S", 0.01)
    told: list[str] = []
    anyio.run(renew, Process("low", shows=False), "for low", told.append)
    assert told == ["low: its process has not got another certificate within 0.01 s"]
