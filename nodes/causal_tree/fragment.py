"""What a part of a network computes: messages that came across its borders in, messages out, and posteriors.

An arrow from another part's node to one of this part's ends at a *guest*: a variable that stands for the parent, has no
prior but the causal support that came down along the arrow, and belongs to this arrow alone. With its guests a part is
a network by itself, and is swept as one."""

import itertools
import math
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.causal_tree.extended_floats import ExtendedFloats, Floats, Inputs, Places, extended, ones
from hierax.nodes.causal_tree.network import Network
from hierax.nodes.causal_tree.plan import plan_of
from hierax.nodes.causal_tree.sweep import NothingLeftError, Product, Sweep

Arrow = tuple[str, str]  # a child and its parent
Messages = Mapping[str, Mapping[str, Floats]]  # by child, then by parent
# By node, the number of the state that it is in without doubt, or likelihoods.
Evidence = Mapping[str, int | tuple[float, ...]]

NOTHING: Messages = {}


class Heard(NamedTuple):
    """What others have told a part: values that are never changed."""

    evidence: Sequence[Evidence]  # of all senders
    slots: Mapping[Arrow, Floats]  # diagnostic support from below, by arrow
    supports: Mapping[Arrow, Floats]  # causal support from above, by arrow


class Upward(NamedTuple):
    """What a part tells those above it."""

    messages: Messages  # diagnostic support, by arrow
    impossible: str | None  # the node where the evidence shows to contradict itself; None where it does not
    certain: bool  # whether nothing but evidence of this epoch was used


class Whole(NamedTuple):
    """What a part tells those below it, and believes."""

    causal: Mapping[Arrow, Floats]  # causal support, by arrow
    posterior: Floats  # shape (nodes, states), or (1, all states) where nodes differ in their numbers of states
    impossible: str | None  # the node where the evidence shows to contradict itself; None where it does not


class Fragment:
    """Some nodes of a network, of which the whole is given, or at least these nodes and their parents; `names` are the
    nodes in the network's order, `sizes` their numbers of states, `ends` the sums of these so far, `states`, by node,
    the states' names."""

    def __init__(self, network: Network, names: Iterable[str]) -> None:
        held = set(names)
        self.names = tuple(name for name in network.variables if isinstance(name, str) and name in held)
        self.states = {name: network.variables[name].states for name in self.names}
        self.sizes = tuple(len(self.states[name]) for name in self.names)
        self._numbers = {name: number for number, name in enumerate(self.names)}
        self._plan, guests = plan_of(network, self.names)
        self._guests: dict[Arrow, int] = {(str(child), str(parent)): guest for (child, parent), guest in guests.items()}
        self._shown = [*self.names, *(child for child, _ in self._guests)]
        self._sweep = Sweep(self._plan)
        self._rooted = set(self._guests.values()) <= set(self._plan.roots)
        self.ends = tuple(itertools.accumulate(self.sizes))
        self._rows = len(self.sizes) if len(set(self.sizes)) == 1 else 1  # filled up, rows could be of any size
        self._places = dict(self._placed())
        self._known: tuple[Heard, str | None] | None = None  # what the last sweep up was of, and what it came to

    def own_evidence(self, evidence: Mapping[str, Any]) -> dict[str, int | tuple[float, ...]]:
        """What of evidence concerns this part. Raises ValueError: likelihoods of a node are not as many as its states,
        or there is no state of that number."""
        mine = [name for name in evidence if name in self._numbers]
        return {name: checked_evidence(evidence[name], len(self.states[name]), name) for name in mine}

    def slots(self, messages: Messages) -> dict[str, dict[str, Floats]]:
        """What of diagnostic support concerns this part: about arrows to it from other parts' nodes."""
        ours, given = self._numbers, by_arrow(messages)
        mine = {arrow: given[arrow] for arrow in given if arrow[0] not in ours and arrow[1] in ours}
        return by_child({arrow: checked(mine[arrow], len(self.states[arrow[1]]), arrow[1]) for arrow in mine})

    def supports(self, messages: Messages) -> dict[str, dict[str, Floats]]:
        """What of causal support concerns this part: about arrows from its nodes to other parts'."""
        given, guests, sizes = by_arrow(messages), self._guests, self._plan.sizes
        mine = [arrow for arrow in given if arrow in guests]
        return by_child({arrow: checked(given[arrow], sizes[guests[arrow]], arrow[1]) for arrow in mine})

    def diagnostic(self, heard: Heard) -> Upward:
        """What goes up; the supports, of the last epoch, are for polytrees."""
        impossible = self._up(heard) if self._rooted else self._swept(heard)
        sent = {}
        for arrow, guest in self._guests.items():
            told = impossible
            if told is not None and not self._rooted:  # what came down along this arrow is no part of what goes up
                told = self._swept(heard._replace(supports=_without(heard.supports, arrow)))
            sent[arrow] = self._towards(guest, told)
        return Upward(by_child(sent), impossible, self._rooted)

    def all(self, heard: Heard) -> Whole:
        """What goes down, and the posteriors."""
        impossible = self._swept(heard)
        if impossible is not None:
            causal = {arrow: self._causal_alone(heard, arrow) for arrow in heard.slots}
            return Whole(causal, np.zeros((self._rows, self.ends[-1] // self._rows)), impossible)
        by_parent: dict[str, list[Arrow]] = {}
        for arrow in heard.slots:
            by_parent.setdefault(arrow[1], []).append(arrow)
        causal = {}
        for parent, arrows in by_parent.items():
            outside = self._without_slots(heard.evidence, parent)
            rest = _each_without(_stacked([unpacked(heard.slots[arrow]) for arrow in arrows]))
            sent = packed(outside.at(None).times(rest))
            causal.update({arrow: np.ascontiguousarray(sent[..., place]) for place, arrow in enumerate(arrows)})
        return Whole(causal, self._posterior(), None)

    def _causal_alone(self, heard: Heard, arrow: Arrow) -> Floats:
        """The causal support of one arrow, where there is a contradiction that may come from what it leaves out."""
        others = _without(heard.slots, arrow)
        parent = arrow[1]
        if self._swept(heard._replace(slots=others)) is not None:
            return packed(ones(len(self.states[parent])))
        found = self._without_slots(heard.evidence, parent)
        for each in others:
            if each[1] == parent:
                found = found.times(unpacked(others[each]))
        return packed(found)

    def _without_slots(self, evidence: Sequence[Evidence], name: str) -> ExtendedFloats:
        """All that is known of a node but by its slots, after a sweep."""
        found = self._sweep.inner(self._numbers[name])
        for each in evidence:
            if name in each:
                found = found.times(extended(self._vector(name, each[name])))
        return found

    def _swept(self, heard: Heard) -> str | None:
        """Sweep; the node where what is known contradicts itself, if it does."""
        told = {self._guests[arrow]: unpacked(message) for arrow, message in heard.supports.items()}
        if not self._rooted:
            return self._try(self._inputs(heard, told), ())
        impossible = self._up(heard)
        if impossible is not None:
            return impossible
        was_extended = self._sweep.is_extended
        contradicts = self._try(None, self._blocks(told))
        if self._sweep.is_extended != was_extended:  # another sweep down should go the same way as this one
            self._known = None
        return contradicts

    def _up(self, heard: Heard) -> str | None:
        """Sweep up, without causal support; if that is not what was done last."""
        known = self._known
        if known is None or not _same(known[0], heard):
            known = self._known = heard, self._try(self._inputs(heard, {}), None)
        return known[1]

    def _try(self, inputs: Inputs | None, at_roots: Inputs | None) -> str | None:
        """Sweep up, down or both."""
        try:
            if inputs is not None:
                self._sweep.up(inputs)
            if at_roots is not None:
                self._sweep.down(at_roots)
        except NothingLeftError as error:
            return self._shown[error.variable]
        return None

    def _inputs(self, heard: Heard, told: Mapping[int, ExtendedFloats]) -> Inputs:
        """The product of what is told of a variable, its slots and the evidence, for each that has any."""
        factors = dict(told)
        for (_, parent), message in heard.slots.items():
            _take_in(factors, self._numbers[parent], unpacked(message))
        alone: dict[int, Floats] = {}
        for each in heard.evidence:
            for name, seen in each.items():
                variable, vector = self._numbers[name], self._vector(name, seen)
                if variable in alone:
                    _take_in(factors, variable, extended(alone.pop(variable)))
                if variable in factors:
                    _take_in(factors, variable, extended(vector))
                else:
                    alone[variable] = vector
        alone_blocks = [
            (size, self._plan.columns[variables], extended(np.array([alone[variable] for variable in variables]).T))
            for size, variables in self._by_size(alone).items()
        ]
        return [*self._blocks(factors), *alone_blocks]

    def _blocks(self, factors: Mapping[int, ExtendedFloats]) -> Inputs:
        return [
            (size, self._plan.columns[variables], _stacked([factors[variable] for variable in variables]))
            for size, variables in self._by_size(factors).items()
        ]

    def _by_size(self, variables: Iterable[int]) -> dict[int, list[int]]:
        found: dict[int, list[int]] = {}
        for variable in variables:
            found.setdefault(self._plan.sizes[variable], []).append(variable)
        return found

    def _vector(self, name: str, seen: int | Sequence[float]) -> Floats:
        """Evidence of a node as likelihoods."""
        if isinstance(seen, int):
            vector = np.zeros(len(self.states[name]))
            vector[seen] = 1.0
            return vector
        return np.array(seen, np.float64)

    def _towards(self, guest: int, impossible: str | None) -> Floats:
        """What the part tells about a guest; ones where its evidence contradicts itself."""
        if impossible is not None:
            return packed(ones(self._plan.sizes[guest]))
        below = self._plan.below.get(guest, ())
        return packed(self._sweep.message_up(*below[0]) if below else self._sweep.support(guest))

    def _posterior(self) -> Floats:
        found = np.zeros(self.ends[-1])
        for size, (mine, places) in self._places.items():
            found[places] = self._sweep.posteriors(size)[mine]
        return found.reshape(self._rows, -1)

    def _placed(self) -> Iterator[tuple[int, tuple[Places, Places]]]:
        """By size, the columns of the part's own nodes, and where their posteriors stand among those of all."""
        starts = np.array(self.ends, np.intp) - self.sizes
        for size, members in self._plan.members.items():
            mine = np.flatnonzero(members < len(self.names))
            if mine.size:
                yield size, (mine, starts[members[mine]][:, None] + np.arange(size))


def _same(one: Heard, other: Heard) -> bool:
    """Whether evidence and slots are the same objects."""
    same_slots = one.slots is other.slots and len(one.evidence) == len(other.evidence)
    return same_slots and all(map(operator.is_, one.evidence, other.evidence))


def _without(messages: Mapping[Arrow, Floats], arrow: Arrow) -> dict[Arrow, Floats]:
    return {each: messages[each] for each in messages if each != arrow}


def _take_in(factors: dict[int, ExtendedFloats], variable: int, factor: ExtendedFloats) -> None:
    known = factors.get(variable)
    factors[variable] = factor if known is None else known.times(factor)


def _stacked(columns: Sequence[ExtendedFloats]) -> ExtendedFloats:
    return ExtendedFloats(*(np.stack(parts, axis=1) for parts in zip(*columns, strict=True)))


def _each_without(factors: ExtendedFloats) -> ExtendedFloats:
    """The product of all other columns, for each column."""
    apart = Product.of(factors)
    joined = apart.rest.products(np.zeros(1, np.intp))
    return Product(joined, apart.zeros.sum(axis=1, keepdims=True)).without(apart)


def packed(message: ExtendedFloats) -> Floats:
    """A message as an array: fractions, then exponents."""
    scaled = message.shifted(0)
    return np.stack([scaled.fraction, scaled.exponent.astype(np.float64)])


def unpacked(message: Floats) -> ExtendedFloats:
    """What `packed` wrote."""
    return ExtendedFloats(message[0], message[1].astype(np.int64))


def checked(message: Floats, size: int, parent: str) -> Floats:
    """A message about a parent with so many states. Raises ValueError: it has another shape."""
    if message.shape != (2, size):
        raise ValueError(f"a message about {parent}: expected shape (2, {size}), got {message.shape}")
    return message


def checked_evidence(seen: Any, size: int, name: str) -> int | tuple[float, ...]:
    """Evidence for a node with so many states. Raises ValueError: there is no state of that number, the likelihoods are
    more or fewer, or they are none."""
    if type(seen) is int:
        if not 0 <= seen < size:
            raise ValueError(f"evidence for {name}: expected a state from 0 to {size - 1}, got {seen}")
        return seen
    if len(seen) != size:
        raise ValueError(f"evidence for {name}: expected {size} likelihoods, got {len(seen)}")
    if not all(0.0 <= each < math.inf for each in seen):
        raise ValueError(f"evidence for {name}: expected finite numbers of at least 0, got {tuple(seen)!r:.60}")
    return tuple(seen)


def by_child(messages: Mapping[Arrow, Floats]) -> dict[str, dict[str, Floats]]:
    """Messages as they travel; `by_arrow` turns them back."""
    found: dict[str, dict[str, Floats]] = {}
    for (child, parent), message in messages.items():
        found.setdefault(child, {})[parent] = message
    return found


def by_arrow(messages: Messages) -> dict[Arrow, Floats]:
    """Messages that have come, by arrow."""
    return {(child, parent): message for child, given in messages.items() for parent, message in given.items()}
