"""What the system is asked for, and what is said where it does not allow that."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable

import pytest

from hierax.runtime.host.scheduling import ask_scheduler


def beside(do: Callable[[], None]) -> None:
    """In a thread of its own, which takes its scheduling with it."""
    thread = threading.Thread(target=do)
    thread.start()
    thread.join()


def test_a_thread_keeps_to_its_processors() -> None:
    (first, *_) = sorted(os.sched_getaffinity(0))
    found = []

    def do() -> None:
        ask_scheduler("arm", "other", 1, (first,))
        found.append(os.sched_getaffinity(0))

    beside(do)
    assert found == [{first}]


def test_who_gives_way_takes_what_computes_for_it_along() -> None:
    found = []

    def do() -> None:
        ask_scheduler("mind", "idle", 1, None)
        found.append(os.sched_getscheduler(0))
        beside(lambda: found.append(os.sched_getscheduler(0)))

    beside(do)
    assert found == [os.SCHED_IDLE, os.SCHED_IDLE]
    assert os.sched_getscheduler(0) != os.SCHED_IDLE


def test_what_is_not_allowed_is_told_once_with_what_would_allow_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    asked = []

    def refuse(process: int, policy: int, given: os.sched_param) -> None:
        asked.append((process, policy & ~os.SCHED_RESET_ON_FORK, given.sched_priority))
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level(logging.WARNING, "hierax"):
        beside(lambda: ask_scheduler("arm", "fifo", 20, None))
    assert asked == [(0, os.SCHED_FIFO, 20)]
    (line,) = caplog.messages
    assert line.startswith("arm: no real-time scheduling (fifo, priority 20): Operation not permitted; root allows it")
    assert "rtprio 20" in line


def test_processors_that_are_not_there_are_told(caplog: pytest.LogCaptureFixture) -> None:
    beside(lambda: ask_scheduler("arm", "other", 1, (4095,)))
    (line,) = caplog.messages
    assert line.startswith("arm: processors [4095]: Invalid argument; it may run on ")
