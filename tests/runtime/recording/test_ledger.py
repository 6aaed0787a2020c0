"""What was said and is not recorded is counted and named; what was recorded is not."""

from __future__ import annotations

from hierax.runtime.recording.ledger import PATIENCE_S, Ledger
from hierax.schemas.roster import Reference, Roster, RosterEdge
from hierax.schemas.steps import NodeStep, Passage

STATE = b""


def step(name: str, number: int, epoch: int, *passages: Passage, stream: str = "s", chain: bytes = b"") -> NodeStep:
    return NodeStep(name, f"{name}-{stream}", number, epoch, 0, 0, 0, 0.0, b"", STATE, passages=passages, chain=chain)


def roster_of(*names: str, **edge: object) -> Roster:
    """A roster of these nodes, the first one below the second where something is said of their edge."""
    nodes = {name: Reference("some.module:Node") for name in names}
    edges = (RosterEdge(names[0], names[1], **edge),) if edge else ()  # type: ignore[arg-type]
    return Roster(names[0], nodes, edges)


def sent(peer: str, epoch: int, attempt: int = 0) -> Passage:
    return Passage(True, "obs", peer, epoch, attempt)


def got(peer: str, epoch: int, attempt: int = 0) -> Passage:
    return Passage(False, "obs", peer, epoch, attempt)


class Clock:
    """A clock that tests turn."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_what_was_heard_is_not_missing_whatever_came_first() -> None:
    ledger = Ledger(from_start=True)
    ledger.message(("obs", "a", "b"), 1, 0)
    ledger.step(step("a", 1, 1, sent("b", 1), sent("b", 2)))
    assert not ledger.settled
    ledger.message(("obs", "a", "b"), 2, 0)
    assert ledger.settled
    assert ledger.close() == ((), 0)


def test_a_message_that_its_sender_names_is_missing() -> None:
    ledger = Ledger(from_start=True)
    ledger.message(("obs", "a", "b"), 3, 0)
    ledger.step(step("a", 1, 3, sent("b", 3), sent("b", 3, attempt=1)))
    gaps, lost = ledger.close()
    assert lost == 1
    assert str(gaps[0]) == "epoch 3: obs message a -> b of attempt 1"


def test_a_message_that_only_its_receiver_names_is_missing() -> None:
    ledger = Ledger(from_start=True)
    ledger.step(step("b", 1, 3, got("a", 3)))
    gaps, lost = ledger.close()
    assert (lost, str(gaps[0])) == (1, "epoch 3: obs message a -> b of attempt 0")


def test_what_a_dead_process_was_sending_is_cut_short() -> None:
    ledger = Ledger(from_start=True)
    ledger.step(step("a", 1, 3, sent("b", 3)))
    ledger.step(step("b", 1, 4, got("a", 3), got("a", 4)))
    ledger.step(step("a", 1, 5, stream="next"))
    gaps, lost = ledger.close()
    assert (lost, str(gaps[0])) == (1, "epoch 3: obs message a -> b of attempt 0")  # it had told of that one
    assert [str(gap) for gap in ledger.cut_short] == ["epoch 4: obs message a -> b of attempt 0"]


def test_epochs_are_committed_by_the_world_alone() -> None:
    ledger = Ledger(from_start=False)
    ledger.step(step("b", 1, 10**12, chain=b"x"))
    ledger.step(step("a", 1, 1, chain=b"x"))
    assert ledger.last == 0  # who the world is, is not known yet
    ledger.expect(roster_of("a", "b"))
    assert ledger.last == 1
    ledger.step(step("b", 2, 10**12, chain=b"x"))
    ledger.step(step("a", 2, 2, chain=b"x"))
    assert ledger.last == 2


def test_a_node_that_does_not_tell_to_the_end_is_named() -> None:
    ledger = Ledger(from_start=True)
    ledger.expect(roster_of("a", "b"))
    ledger.step(step("a", 1, 1, chain=b"x"))
    ledger.step(step("a", 2, 2, chain=b"x"))
    ledger.step(step("b", 1, 1))
    gaps, lost = ledger.close(last=2)
    assert (lost, str(gaps[0])) == (1, "epoch 2: steps of b from here on")


def test_what_was_told_of_epochs_after_the_last_one_that_is_wanted_is_not_missed() -> None:
    """A node may be an epoch ahead of the world, or more has come in, before it is known where a recording ends."""
    ledger = Ledger(from_start=True)
    ledger.expect(roster_of("a", "b"))
    ledger.message(("obs", "a", "b"), 37, 0)
    ledger.step(step("a", 1, 37, sent("b", 37), sent("b", 38)))
    ledger.step(step("a", 2, 38, sent("b", 38), chain=b"x"))
    assert not ledger.settled
    ledger.end(37)
    assert ledger.settled
    assert not ledger.complete, "b has not told of it"
    ledger.step(step("b", 1, 37, got("a", 37)))
    assert ledger.complete
    assert ledger.close(37) == ((), 0)


def test_who_has_left_is_not_waited_for() -> None:
    ledger = Ledger(from_start=True)
    ledger.expect(roster_of("a", "b"))
    ledger.step(step("b", 1, 1))
    ledger.expect(roster_of("a"))
    ledger.step(step("a", 1, 2))
    ledger.end(2)
    assert ledger.complete


def test_steps_are_counted_in_their_stream() -> None:
    ledger = Ledger(from_start=True)
    for number, epoch in ((1, 1), (2, 2), (5, 5)):
        ledger.step(step("a", number, epoch))
    ledger.step(step("a", 1, 6, stream="next"))  # another process of the node
    ledger.step(step("a", 3, 8, stream="next"))
    gaps, lost = ledger.close()
    assert lost == 3
    assert [(gap.epoch, gap.what, gap.count) for gap in gaps] == [
        (5, "steps of a before this one", 2),
        (8, "steps of a before this one", 1),
    ]


def test_a_step_that_comes_after_the_next_one_does_not_lack() -> None:
    ledger = Ledger(from_start=True)
    for number in (1, 3, 2, 4, 6, 7):
        ledger.step(step("a", number, number))
    assert [str(gap) for gap in ledger.close()[0]] == ["epoch 6: steps of a before this one"]
    ledger = Ledger(from_start=True)
    for number, stream in ((1, "s"), (3, "s"), (2, "t")):
        ledger.step(step("a", number, number, stream=stream))
    assert ledger.close()[1] == 2


def test_a_node_that_told_nothing_is_named() -> None:
    ledger = Ledger(from_start=True)
    ledger.expect(roster_of("a", "b"))
    ledger.step(step("a", 1, 1))
    gaps, lost = ledger.close()
    assert (lost, gaps[0].what) == (1, "all steps of b")


def test_begun_in_the_middle_it_counts_from_the_first_whole_epoch() -> None:
    ledger = Ledger(from_start=False)
    ledger.expect(roster_of("a", "b"))
    ledger.step(step("a", 7, 10, got("b", 10)))
    assert ledger.first == 0
    ledger.step(step("b", 3, 11, sent("a", 11)))
    assert ledger.first == 12
    ledger.step(step("b", 4, 12, sent("a", 12)))
    gaps, lost = ledger.close()
    assert (lost, gaps[0].epoch) == (1, 12)


def test_what_comes_after_long_is_missing() -> None:
    clock = Clock()
    ledger = Ledger(from_start=True, clock=clock)
    ledger.message(("obs", "a", "b"), 1, 0)
    ledger.step(step("a", 1, 1, sent("b", 1), sent("c", 1)))
    clock.now_s = PATIENCE_S + 1
    ledger.message(("obs", "a", "b"), 2, 0)
    assert ledger.settled  # it is told by now, and forgotten
    gaps, lost = ledger.close()
    assert (lost, str(gaps[0])) == (1, "epoch 1: obs message a -> c of attempt 0")


def test_beyond_the_cut_nothing_is_wanted() -> None:
    ledger = Ledger(from_start=True)
    ledger.step(step("a", 1, 1, sent("b", 1), chain=b"x"))
    ledger.message(("obs", "a", "b"), 1, 0)
    ledger.end(ledger.last)
    assert ledger.complete
    ledger.step(step("a", 2, 2, sent("b", 2)))
    assert ledger.complete
    assert ledger.close() == ((), 0)
