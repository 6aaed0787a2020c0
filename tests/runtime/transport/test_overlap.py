"""What two sessions of a recorder hear, one after the other and both for a while, counts once."""

from __future__ import annotations

import random

import pytest

from hierax.runtime.transport.overlap import Overlap
from hierax.runtime.transport.port import Sample

SPEAKERS, WORDS = 3, 40


def said_by(rng: random.Random, speaker: int) -> list[Sample]:
    """What one says; some of it more than once."""
    return [Sample(0, f"steps/{speaker}", str(rng.choice((number, 7))).encode()) for number in range(WORDS)]


def shuffled(rng: random.Random, heard: list[list[Sample]]) -> list[Sample]:
    """What is heard of several, each in its order, and otherwise in any."""
    left = [list(each) for each in heard]
    drawn = []
    while left := [each for each in left if each]:
        drawn.append(rng.choice(left).pop(0))
    return drawn


@pytest.mark.parametrize("seed", range(200))
def test_each_sample_counts_once_and_in_the_order_of_who_said_it(seed: int) -> None:
    rng = random.Random(seed)
    said = [said_by(rng, speaker) for speaker in range(SPEAKERS)]
    # of each, the next one hears from some word on, and the one before up to a later one
    begins = [rng.randrange(WORDS // 2) for _ in said]
    ends = [rng.randrange(begin, WORDS + 1) for begin in begins]
    before = shuffled(rng, [words[:end] for words, end in zip(said, ends, strict=True)])
    after = shuffled(rng, [words[begin:] for words, begin in zip(said, begins, strict=True)])
    overlap, counted, waiting = Overlap(), [], 0
    while before or after:
        if before and (not after or rng.random() < 0.5):
            counted.append(before.pop(0))
            waiting -= overlap.before(counted[-1])
        else:
            waiting += overlap.next(after.pop(0))
    rest = overlap.rest()
    assert waiting == sum(len(each.data) for each in rest)
    for words, begin, end in zip(said, begins, ends, strict=True):
        of_one = [each for each in counted + rest if each.key == words[0].key]
        assert of_one[:end] == words[:end], seed
        # what was said again in the same bytes may be taken for what was heard before the next one listened
        repeated = [each for each in words[end:] if each in words[:begin]]
        lacking = [each for each in words[end:] if each not in of_one[end:]]
        assert all(each in repeated for each in lacking), seed
        assert [each for each in of_one[end:] if each not in repeated] == [
            each for each in words[end:] if each not in repeated
        ], seed


def test_it_is_whole_when_the_next_one_has_heard_of_all() -> None:
    overlap = Overlap()
    assert overlap.is_whole
    overlap.before(Sample(0, "steps/low", b"1"))
    overlap.before(Sample(0, "steps/high", b"1"))
    overlap.next(Sample(0, "steps/high", b"2"))
    assert not overlap.is_whole
    overlap.next(Sample(0, "steps/low", b"1"))
    assert overlap.is_whole
