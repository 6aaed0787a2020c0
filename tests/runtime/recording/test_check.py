"""A run in good order passes; each rule notices what breaks it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.recording.check import Checker, check_recording
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.topics import MESSAGE, ROSTER, STEP
from hierax.schemas.messages import Message, decode_message, encode_message
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep, Passage


class Said(NamedTuple):
    """All that a checker sees, in order."""

    things: list[Message | NodeStep | Roster]

    def check(self) -> Checker:
        checker = Checker()
        for thing in self.things:
            if isinstance(thing, Message):
                checker.message(encode_message(thing))
            elif isinstance(thing, NodeStep):
                checker.step(thing)
            else:
                checker.roster(thing)
        checker.close()
        return checker


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return record_file(folder / "run.mcap", path)[0]


@pytest.fixture
def said(recording: Recording) -> Said:
    things: list[Message | NodeStep | Roster] = []
    for entry in recording.entries(MESSAGE, STEP, ROSTER):
        what = entry.topic.what
        things.append(entry.message() if what == MESSAGE else entry.step() if what == STEP else entry.roster())
    return Said(things)


def test_a_run_in_good_order_passes(recording: Recording, said: Said) -> None:
    checker = check_recording(recording)
    assert (checker.epochs, checker.checked, checker.violations) == (12, 36, [])
    assert said.check().violations == []


def test_overlapping_epochs_in_good_order_pass(tmp_path: Path) -> None:
    for settings in (("staleness=2",), ("staleness=null",)):
        recording, _ = record_file(tmp_path / "run.mcap", "servo", *settings)
        assert check_recording(recording).violations == [], settings


def messages(said: Said, kind: str, sender: str, epoch: int) -> list[int]:
    return [
        index
        for index, thing in enumerate(said.things)
        if isinstance(thing, Message) and thing.header[:2] == (kind, sender) and thing.header.epoch == epoch
    ]


def steps(said: Said, name: str, epoch: int) -> list[int]:
    return [
        index
        for index, thing in enumerate(said.things)
        if isinstance(thing, NodeStep) and (thing.name, thing.epoch) == (name, epoch)
    ]


def rehead(said: Said, kind: str, sender: str, **fields: object) -> None:
    (index,) = messages(said, kind, sender, 5)
    message = said.things[index]
    assert isinstance(message, Message)
    said.things[index] = message._replace(header=message.header._replace(**fields))  # type: ignore[arg-type]


def restep(said: Said, name: str, change: Callable[[NodeStep], NodeStep]) -> None:
    (index,) = steps(said, name, 5)
    step = said.things[index]
    assert isinstance(step, NodeStep)
    said.things[index] = change(step)


def moved(step: NodeStep, passage: Passage, before: Passage) -> NodeStep:
    """The step with one passage put before another."""
    passages = [each for each in step.passages if each != passage]
    assert len(passages) == len(step.passages) - 1
    passages.insert(passages.index(before), passage)
    return step._replace(passages=tuple(passages))


def without(step: NodeStep, passage: Passage) -> NodeStep:
    assert passage in step.passages
    return step._replace(passages=tuple(each for each in step.passages if each != passage))


UP = Passage(True, "obs", "high", 5, 0)
FROM_BELOW = Passage(False, "obs", "world", 5, 0)
FROM_ABOVE = Passage(False, "ctx", "high", 5, 0)
TASK_FROM_ABOVE = Passage(False, "task", "high", 5, 0)
TASK_DOWN = Passage(True, "task", "world", 5, 0)
DOWN = Passage(True, "ctx", "world", 5, 0)


def second_message(said: Said) -> None:
    (index,) = messages(said, "obs", "low", 5)
    message = said.things[index]
    assert isinstance(message, Message)
    said.things.insert(index + 1, message._replace(payload=({"level": 9.0},)))


def commit_again(said: Said) -> None:
    (index,) = steps(said, "world", 5)
    step = said.things[index]
    assert isinstance(step, NodeStep)
    said.things.insert(index + 1, step._replace(number=step.number + 1, attempt=1))


def bad_roster(said: Said) -> None:
    roster = next(thing for thing in said.things if isinstance(thing, Roster))
    said.things.append(Roster(roster.world, roster.nodes, roster.edges[:1], 1, {}))


BROKEN: dict[str, tuple[str, Callable[[Said], None]]] = {
    "along no edge": ("EDGE", lambda said: rehead(said, "obs", "low", receiver="world")),
    "another instance": ("EDGE", lambda said: rehead(said, "ctx", "high", instance=3)),
    "twice, unlike": ("ONCE", second_message),
    "observations before those below": ("SENSE", lambda said: restep(said, "low", lambda s: moved(s, UP, FROM_BELOW))),
    "without observations": ("SENSE", lambda said: restep(said, "low", lambda s: without(s, FROM_BELOW))),
    "down before up": ("UP", lambda said: restep(said, "low", lambda s: moved(s, TASK_DOWN, UP))),
    "before context": ("PREDICT", lambda said: restep(said, "low", lambda s: moved(s, DOWN, FROM_ABOVE))),
    "before tasks": ("PREDICT", lambda said: restep(said, "low", lambda s: moved(s, TASK_DOWN, TASK_FROM_ABOVE))),
    "without tasks": ("PREDICT", lambda said: restep(said, "low", lambda s: without(s, TASK_FROM_ABOVE))),
    "context not sent": ("ALL", lambda said: restep(said, "low", lambda s: without(s, DOWN))),
    "of an older epoch": (
        "EPOCH",
        lambda said: restep(said, "low", lambda s: s._replace(used=(("high", "ctx", 4, 0),))),
    ),
    "another time": ("TIME", lambda said: rehead(said, "ctx", "high", time_s=0.5)),
    "committed twice": ("COMMIT", commit_again),
    "after the commit": ("COMMIT", lambda said: rehead(said, "ctx", "low", attempt=1)),
    "another state": ("DIGEST", lambda said: restep(said, "low", lambda s: s._replace(state=s.state[:-1] + b"\7"))),
    "context of another epoch": ("DIGEST", lambda said: rehead(said, "ctx", "high", digest=bytes(32))),
    "a broken chain": ("DIGEST", lambda said: restep(said, "world", lambda s: s._replace(chain=bytes(32)))),
    "no hierarchy": ("GRAPH", bad_roster),
}


def test_tasks_may_go_down_before_context_has_come(said: Said) -> None:
    restep(said, "low", lambda s: moved(moved(s, TASK_DOWN, FROM_ABOVE), TASK_FROM_ABOVE, TASK_DOWN))
    assert said.check().violations == []


@pytest.mark.parametrize("what", sorted(BROKEN))
def test_each_rule_notices_what_breaks_it(what: str, said: Said) -> None:
    rule, breaks = BROKEN[what]
    if what == "after the commit":  # it comes late, as a message of an attempt that nobody needs
        (index,) = messages(said, "ctx", "low", 5)
        message = said.things[index]
        (commit,) = steps(said, "world", 5)
        assert isinstance(message, Message)
        said.things.insert(commit + 1, message._replace(header=message.header._replace(attempt=1)))
    else:
        breaks(said)
    found = said.check().violations
    assert rule in {violation.rule for violation in found}, found


def test_what_a_port_saw_before_anybody_recorded_is_no_violation(said: Said) -> None:
    later = [
        thing
        for thing in said.things
        if isinstance(thing, Roster)
        or (isinstance(thing, Message) and thing.header.epoch >= 5)
        or (isinstance(thing, NodeStep) and thing.epoch >= 5)
    ]
    cut = [
        thing._replace(passages=thing.passages[1:], number=1)
        if isinstance(thing, NodeStep) and thing.epoch == 5
        else thing
        for thing in later
    ]
    assert Said(cut).check().violations == []


def test_messages_are_read_as_they_were(said: Said) -> None:
    message = next(thing for thing in said.things if isinstance(thing, Message))
    assert decode_message(encode_message(message)) == message
