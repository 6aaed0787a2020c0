"""What is said again and again is said some times, and counted."""

from __future__ import annotations

import logging

from hierax.runtime.watch.logs import FIRST, OURS, Throttle


class Told:
    """A logger's records, through a throttle, at a time that a test says."""

    def __init__(self) -> None:
        self.now = 0.0
        self.throttle = Throttle(lambda: self.now)
        self.lines: list[str] = []

    def say(self, text: str, *arguments: object, name: str = OURS, level: int = logging.WARNING) -> None:
        record = logging.makeLogRecord({"name": name, "levelno": level, "msg": text, "args": arguments})
        passes = self.throttle.filter(record)
        assert self.throttle.filter(record) is passes, "another handler is told the same"
        if passes:
            self.lines.append(record.getMessage())


def test_of_a_hundred_thousand_refusals_some_lines_are_left_and_all_are_counted() -> None:
    told = Told()
    count = 100_000
    for number in range(count):
        told.now = number * 1e-3
        told.say("refused message %d", number)
    assert FIRST < len(told.lines) < 100
    counted = sum(int(line.split("(and ")[1].split(" ")[0]) for line in told.lines if "more like it" in line)
    left = sum(each for _, _, each in told.throttle.take_left_out())
    assert counted + left + len(told.lines) == count
    assert told.throttle.take_left_out() == []


def test_other_kinds_errors_and_a_nodes_own_records_are_not_left_out() -> None:
    told = Told()
    for number in range(100):
        told.say("again")
        told.say("a node's own", name="robots.arm")
        told.say("it has failed", level=logging.ERROR)
        told.say(f"kind {number}")
    assert len(told.lines) == 3 * 100 + FIRST


def test_what_is_said_now_and_then_is_always_told() -> None:
    told = Told()
    for _ in range(100):
        told.now += 2.0
        told.say("a node was lost")
    assert told.lines == ["a node was lost"] * 100


def test_what_was_quiet_for_long_begins_anew() -> None:
    told = Told()
    for _ in range(FIRST + 42):
        told.say("refused")
    told.now += 100.0
    told.say("refused")
    assert told.lines[-1] == "refused (and 42 more like it in the last 100 s)"
    told.now += 100.0
    for _ in range(FIRST):
        told.say("refused")
    assert told.lines[-FIRST:] == ["refused"] * FIRST


def test_of_what_was_left_out_at_the_end_the_last_one_is_told() -> None:
    told = Told()
    for number in range(FIRST + 3):
        told.say("%s: dropped %d", "world", number)
    assert told.throttle.take_left_out() == [(logging.WARNING, f"world: dropped {FIRST + 2}", 3)]
