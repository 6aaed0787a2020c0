"""Which epochs come next at a node: those that somebody needs, and drained ones."""

from __future__ import annotations

from hierax.runtime.engine.coming import ComingEpochs
from hierax.schemas.rates import EVERY_EPOCH, Rates, Turns


def test_what_comes_is_what_somebody_needs() -> None:
    coming = ComingEpochs((Turns(20, 7), Turns(30)), 0)
    found = []
    for _ in range(6):
        found.append(coming.next)
        coming.look_on(coming.next)
    assert found == [7, 27, 30, 47, 60, 67]
    assert coming.include(coming.next, is_drained=False)
    assert coming.include(127, is_drained=False)
    assert not coming.include(88, is_drained=False)
    assert not coming.include(67, is_drained=False), "it is past"


def test_a_drained_epoch_comes_before_the_next_one_that_is_needed() -> None:
    coming = ComingEpochs((Turns(20),), 1)
    assert coming.epochs == (20,)
    assert coming.include(5, is_drained=True)
    assert coming.include(3, is_drained=True)
    assert coming.include(25, is_drained=True)
    assert coming.epochs == (3, 5, 20)
    coming.begin((EVERY_EPOCH,), 3)
    assert coming.epochs == (4,)
    coming.look_on(4)
    assert coming.epochs == (5,)


def test_a_node_is_sent_what_it_who_is_above_and_who_gathers_need() -> None:
    pairs = (("w", "a"), ("a", "b"), ("b", "c"), ("w", "d"), ("a", "d"))
    turns = {"a": Turns(4, 1), "b": Turns(20, 7), "c": Turns(30), "d": Turns(9)}
    rates = Rates(turns, gathers=frozenset({("a", "d")}), pairs=pairs)
    assert rates.passes("c") == (Turns(30),)
    assert rates.passes("b") == (Turns(20, 7), Turns(30))
    assert rates.passes("d") == (Turns(4, 1), Turns(9))
    assert rates.passes("a") == (Turns(4, 1), Turns(9), Turns(20, 7), Turns(30))
    assert rates.passes("w") == (EVERY_EPOCH,)
    assert Rates(turns).passes("c") == (EVERY_EPOCH,), "who is above is not known"
