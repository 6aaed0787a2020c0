"""The vocabulary: which letters the words have at which place.

The conditional probabilities of a letter given a word are 0 or 1 here: M[w, l] = 1 where word w has letter l at the
place.
"""

from __future__ import annotations

from collections.abc import Sequence

from hierax.nodes.letters.messages import Weights, normalised


def check_words(words: Sequence[str]) -> tuple[str, ...]:
    """The vocabulary of a deployment. Raises ValueError: these are not different words of one length."""
    if isinstance(words, str) or not words or not all(isinstance(word, str) and word for word in words):
        raise ValueError(f"words: expected a list of words, got {words!r}")
    if len({len(word) for word in words}) > 1 or len(set(words)) < len(words):
        raise ValueError(f"words: expected different words of one length, got {', '.join(words)}")
    return tuple(words)


def letters_at(words: Sequence[str], letter: int) -> tuple[str, ...]:
    """The hypotheses of a letter node: the letters at a place, in the order of the words.

    Args: words: the vocabulary; letter: the place, from 1.
    Raises ValueError: the words have no such place.
    """
    words = check_words(words)
    if not isinstance(letter, int) or not 1 <= letter <= len(words[0]):
        raise ValueError(f"letter: expected a place from 1 to {len(words[0])}, got {letter!r}")
    return tuple(dict.fromkeys(word[letter - 1] for word in words))


def words_given_letter(words: Sequence[str], letter: int, likelihood: Weights) -> dict[str, float]:
    """η·M·L: what a letter's likelihood tells of the words."""
    return normalised({word: likelihood[word[letter - 1]] for word in words}, f"letter {letter}")


def letters_given_word(words: Sequence[str], letter: int, belief: Weights) -> dict[str, float]:
    """η·b·M: what is expected of a letter, given a message over the words."""
    expected = dict.fromkeys(letters_at(words, letter), 0.0)
    for word in words:
        expected[word[letter - 1]] += belief[word]
    return normalised(expected, f"letter {letter}")
