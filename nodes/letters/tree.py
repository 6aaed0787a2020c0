"""Letters under a word: perceptual context by belief propagation (example 1 of arXiv 1801.02270).

The paper embeds Pearl's belief propagation (Pearl 1988, chapter 4) in a cognitive hierarchy: a belief holds diagnostic
parts, which come from below, and causal support, which comes from above. It is built here so that one Update is exact
for any likelihoods: slots are keyed by the child's name, a missing part is uniform, and the context for a letter leaves
out what that letter said itself.

A belief is ``{"diagnostic": …, "causal": …, "posterior": …}``, each part by hypothesis and of sum 1; the posterior
follows from the other two and is kept to be read. 0 means impossible, exactly: products keep their exponents apart,
and what would underflow stays at `TINY`, so that later evidence can still choose it."""

import math
import sys
from collections.abc import Iterable, Mapping, Sequence

from hierax.runtime import NO_TICK, Elements, Node, Step, Tick, Value, World
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.node import structural_difference
from hierax.runtime.core.showing import Curve, Things, colour_of

UNKNOWN = "?"  # in a string of letters, the one of which the sign tells nothing

Weights = Mapping[str, float]

TINY = sys.float_info.min  # the least number other than 0 in a message


def check_words(words: Sequence[str]) -> tuple[str, ...]:
    """The vocabulary of a deployment. Raises ValueError: these are not different words of one length."""
    if isinstance(words, str) or not words or not all(isinstance(word, str) and word for word in words):
        raise ValueError(f"words: expected a list of words, got {words!r}")
    if len({len(word) for word in words}) > 1 or len(set(words)) < len(words):
        raise ValueError(f"words: expected different words of one length, got {', '.join(words)}")
    return tuple(words)


def letters_at(words: Sequence[str], letter: int) -> tuple[str, ...]:
    """The hypotheses of a letter node: the letters at a place, from 1, in the order of the words. Raises ValueError:
    the words have no such place."""
    words = check_words(words)
    if not isinstance(letter, int) or not 1 <= letter <= len(words[0]):
        raise ValueError(f"letter: expected a place from 1 to {len(words[0])}, got {letter!r}")
    return tuple(dict.fromkeys(word[letter - 1] for word in words))


class SymbolWorld(World):
    """N₀: a row of signs, given by what each of them tells of its letter.

    Belief: ``{"likelihoods": ({letter: p, …}, …)}``, p(sign | letter) by place, up to a factor.

    Args:
        words: the vocabulary; place i has the letters that the words have there, in their order.
        likelihoods: for each place, one number per letter.
        letters: signs by name instead, such as ``C?T``: a letter is seen without doubt, ``?`` tells nothing.

    Raises ValueError: they do not fit the words."""

    def __init__(
        self, words: Sequence[str], likelihoods: Sequence[Sequence[float]], letters: str | None = None
    ) -> None:
        self._words = check_words(words)
        if letters is not None:
            likelihoods = self._likelihoods_of(letters)
        if len(likelihoods) != len(self._words[0]):
            raise ValueError(f"likelihoods: expected {len(self._words[0])} lists, got {len(likelihoods)}")
        self._likelihoods = tuple(
            weights(letters_at(self._words, place), values, f"likelihoods: letter {place}")
            for place, values in enumerate(likelihoods, start=1)
        )

    def initial_belief(self) -> Value:
        """What the signs tell; it stays."""
        return {"likelihoods": self._likelihoods}

    def _likelihoods_of(self, letters: str) -> list[list[float]]:
        if not isinstance(letters, str) or len(letters) != len(self._words[0]):
            raise ValueError(f"letters: expected {len(self._words[0])} letters, got {letters!r}")
        result = []
        for place, sign in enumerate(letters, start=1):
            known = letters_at(self._words, place)
            if sign not in (*known, UNKNOWN):
                raise ValueError(f"letters: expected one of {', '.join(known)} or {UNKNOWN} at {place}, got {sign!r}")
            result.append([float(sign in (name, UNKNOWN)) for name in known])
        return result


def symbol_seen(belief: Value, letter: int) -> Elements:
    """φ from the world to a letter node: the likelihoods of the sign at a place (from 1)."""
    return (belief["likelihoods"][letter - 1],)


class _HypothesesNode(Node):
    """A node whose belief has a posterior over hypotheses."""

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """The posterior, by hypothesis."""
        return dict(belief["posterior"])

    def show(self, step: Step, before: Value) -> Things:
        """The posterior, a curve for each hypothesis."""
        shares = enumerate(step.belief["posterior"].items(), start=1)
        return {f"posterior/{name}": Curve(share, colour_of(number)) for number, (name, share) in shares}


class LetterNode(_HypothesesNode):
    """N₁, N₂, N₃: which letter, of those that the words have at a place from 1, a sign is. ``diagnostic`` is p(sign |
    letter), ``causal`` what the word expects there; both are uniform until something is known."""

    def __init__(self, words: Sequence[str], letter: int) -> None:
        self.names = letters_at(words, letter)

    def initial_belief(self) -> Value:
        """No evidence, no expectation."""
        return self._belief(uniform(self.names), uniform(self.names))

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ: the sign's likelihoods, by letter and independent of one another, take the diagnostic part's place;
        without any it stays. Raises ImpossibleEvidenceError: they leave no letter."""
        if not observations:
            return belief
        diagnostic = product(self.names, (self.likelihood(seen) for seen in observations), "the sign")
        return self._belief(diagnostic, belief["causal"])

    def likelihood(self, observation: Value) -> Weights:
        """p(observation | letter) by letter, up to a factor: here the observation itself. Raises ValueError: it is not
        about this node's letters."""
        if not isinstance(observation, Mapping) or set(observation) != set(self.names):
            raise ValueError(f"expected the likelihoods of {', '.join(self.names)}, got {observation!r}")
        return observation

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: the context takes the causal support's place; without any it stays. Raises ImpossibleEvidenceError: the
        context leaves nothing of what was seen."""
        if not context:
            return belief
        return self._belief(belief["diagnostic"], product(self.names, context, "the context"))

    def _belief(self, diagnostic: Weights, causal: Weights) -> Value:
        posterior = product(self.names, (diagnostic, causal), "the sign in its context")
        return {"diagnostic": diagnostic, "causal": causal, "posterior": posterior}


class WordNode(_HypothesesNode):
    """N₄: which word the letters are. ``diagnostic`` has a part for each letter node, by its name; ``causal`` is the
    prior, one number of 0 or more for each word, up to a factor; by default all are equal. Raises ValueError: these are
    no words or no priors."""

    def __init__(self, words: Sequence[str], priors: Sequence[float] | None = None) -> None:
        self.names = check_words(words)
        self._priors = uniform(self.names) if priors is None else weights(self.names, priors, "priors")

    def initial_belief(self) -> Value:
        """No evidence: the posterior is the prior."""
        return self._belief({})

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ: what a letter node reports, ``{"from": node, "likelihood": {word: p, …}}``, takes the place of its part;
        the others stay. Raises ImpossibleEvidenceError: the letters leave no word that has a prior."""
        reported = {seen["from"]: seen["likelihood"] for seen in observations}
        return self._belief({**belief["diagnostic"], **reported})

    def take_over(self, belief: Value) -> Value:
        """What the letter nodes have reported to another word node, under this one's prior. Raises ValueError: it is no
        belief over these words. ImpossibleEvidenceError: the reports leave no word that has a prior."""
        parts = belief.get("diagnostic") if isinstance(belief, dict) else None
        reported = parts if isinstance(parts, dict) else {}
        difference = structural_difference(self._belief(dict.fromkeys(reported, uniform(self.names))), belief)
        if difference:
            raise ValueError(difference)
        return self._belief(reported)

    def _belief(self, diagnostic: Mapping[str, Weights]) -> Value:
        what = f"{', '.join(diagnostic)} together" if diagnostic else "the prior"
        posterior = product(self.names, (*diagnostic.values(), self._priors), what)
        return {"diagnostic": diagnostic, "causal": self._priors, "posterior": posterior}


class _Place:
    """An edge function of a place (from 1) in words; M[w, l] is 1 where word w has letter l there, else 0."""

    def __init__(self, words: Sequence[str], letter: int) -> None:
        letters_at(words, letter)
        self._words = check_words(words)
        self._letter = letter


class LetterEvidence(_Place):
    """φ from a letter node to the word: η·M·L, its diagnostic part as one over the words."""

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        """One observation, signed with the letter node's name."""
        told = {word: belief["diagnostic"][word[self._letter - 1]] for word in self._words}
        return ({"from": _lower_name(tick), "likelihood": normalised(told, f"letter {self._letter}")},)


class WordSupport(_Place):
    """ϱ from the word to a letter node: η·(c ∘ all parts but the letter's own)·M."""

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        """One context element: what the rest of the word expects at the place, by letter. Raises
        ImpossibleEvidenceError: the other letters leave no word."""
        own = _lower_name(tick)
        others = [part for name, part in belief["diagnostic"].items() if name != own]
        rest = product(self._words, (*others, belief["causal"]), f"all letters but {own}")
        expected = dict.fromkeys(letters_at(self._words, self._letter), 0.0)
        for word in self._words:
            expected[word[self._letter - 1]] += rest[word]
        return (normalised(expected, f"letter {self._letter}"),)


def _lower_name(tick: Tick) -> str:
    return tick.below[0] if tick.below else ""


class ImpossibleEvidenceError(HieraxError):
    """Every hypothesis has probability 0: there is nothing to normalise."""


def uniform(names: Sequence[str]) -> dict[str, float]:
    """The message that tells nothing."""
    return {name: 1.0 / len(names) for name in names}


def is_number(value: object) -> bool:
    """Whether a parameter is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def weights(names: Sequence[str], values: Sequence[float], what: str) -> dict[str, float]:
    """Numbers that a user gave as a parameter, one of 0 or more for each hypothesis and not all 0, as a message. Raises
    ValueError: they are none."""
    expected = f"{what}: expected {len(names)} numbers, for {', '.join(names)}"
    if isinstance(values, (str, bytes)) or not isinstance(values, Sequence) or len(values) != len(names):
        raise ValueError(f"{expected}; got {values!r}")
    for value in values:
        if not is_number(value) or value < 0:
            raise ValueError(f"{expected}, each finite and at least 0; got {value!r}")
    if not any(values):
        raise ValueError(f"{expected}, at least one of them more than 0; got {list(values)}")
    return normalised(dict(zip(names, values, strict=True)), what)


def normalised(message: Weights, what: str) -> dict[str, float]:
    """The message scaled to sum 1. Raises ImpossibleEvidenceError: all is 0; `what` says of which message."""
    top = max(message.values())
    if not top > 0:
        raise ImpossibleEvidenceError(f"{what}: the evidence is impossible, nothing is left of {', '.join(message)}")
    scaled = {name: value / top for name, value in message.items()}
    total = math.fsum(scaled.values())
    return {name: max(scaled[name] / total, TINY) if value > 0 else 0.0 for name, value in message.items()}


def product(names: Sequence[str], factors: Iterable[Weights], what: str) -> dict[str, float]:
    """The normalised element-wise product of messages; of none, the uniform one. Raises ImpossibleEvidenceError: the
    product is 0 everywhere."""
    factors = tuple(factors)
    parts = {name: _extended_product(factor[name] for factor in factors) for name in names}
    top = max((exponent for fraction, exponent in parts.values() if fraction > 0), default=0)
    message = {
        name: max(math.ldexp(fraction, exponent - top), TINY) if fraction > 0 else 0.0
        for name, (fraction, exponent) in parts.items()
    }
    return normalised(message, what)


def _extended_product(values: Iterable[float]) -> tuple[float, int]:
    """The product as (fraction, exponent of 2), which cannot underflow."""
    fraction, exponent = 1.0, 0
    for value in values:
        part, part_exponent = math.frexp(value)
        fraction, shift = math.frexp(fraction * part)
        exponent += part_exponent + shift
    return fraction, exponent
