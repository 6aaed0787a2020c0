"""What happens in one simulation: all of it follows from a seed, and can be made smaller."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from random import Random

from hierax.runtime.sim.nodes import MODULE
from hierax.schemas.control import Propose
from hierax.schemas.rates import Pair
from hierax.schemas.roster import FUNCTIONS, Attach, Change, Detach, Reference, Replace, Roster, RosterEdge, new_nodes

CRASH, WORLD, TORN, DAMAGE = "crash", "world", "torn", "damage"
LOSS, DOUBLE, REORDER, DELAY, PARTITION = "loss", "double", "reorder", "delay", "partition"
HANG, PAUSE, SLOW = "hang", "pause", "slow"
BREAK, RAISE, TRIAL = "break", "raise", "trial"
STRAY, FORETELL, CONTRADICT = "stray", "foretell", "contradict"
OF_MESSAGES = (LOSS, DOUBLE, REORDER, DELAY)
FORGED = (STRAY, FORETELL, CONTRADICT)
FAULTS = (CRASH, WORLD, TORN, DAMAGE, *OF_MESSAGES, PARTITION, HANG, PAUSE, SLOW, RAISE, *FORGED, BREAK, TRIAL)
"""All kinds of faults.

crash: a node's process dies at one of its calls. world: so does the world's. torn: a
process dies in the middle of a write. damage: after its death, a slot is found damaged.
loss, double, reorder, delay: messages are lost, come twice, overtake one another, or take
long, for a while. partition: processes are cut off and joined again. hang: a process sits
in an operator; pause: it does not run at all; slow: it takes its time for a while. break:
the link between two processes breaks, what is under way on it is lost, and after a while
it is mended, which both are told. raise: an operator or edge function raises, of a node
that fails alone; trial: of any that replaces another, in its first epoch. stray, foretell,
contradict: somebody else makes another message of one that a process has taken in: one
that has no place there; one of an attempt that nobody has begun; one that says something
else, which ends the run.
"""

_SHARES = {RAISE: 0.5, STRAY: 0.3, FORETELL: 0.3, CONTRADICT: 0.16}
"""Faults that are drawn apart from the others, as they end runs, or need a node that fails alone: in how many seeds."""

RATED_FAULTS = tuple(kind for kind in FAULTS if kind not in (RAISE, TRIAL))
"""Those that befall hierarchies with rates, of which no node fails alone."""

_OF_WORLD = {
    WORLD: 1.0, TORN: 0.3, DAMAGE: 0.3, PAUSE: 0.2, SLOW: 0.2, PARTITION: 0.1, STRAY: 0.5, CONTRADICT: 0.3
}  # fmt: skip
"""How often a fault befalls the world's process; else it is any other's."""

_NEED_DEADLINE = frozenset({DAMAGE, LOSS, PARTITION, HANG})
"""Faults after which a run may need the epoch's deadline to go on."""

WORLD_NAME = "world"
NAMES = tuple(f"n{index}" for index in range(8))
REJOIN_S = 0.5  # how long an attached node may take to come back
EPOCH_S = 0.012  # about how long an epoch takes, faults apart


@dataclass(frozen=True)
class Fault:
    """One fault."""

    kind: str  # one of `FAULTS`
    at_s: float  # when; the network's last `for_s`
    name: str = ""  # whom it befalls, where it befalls a process
    number: int = 0  # at which of its calls a process dies; of a link that breaks, to which other process; else free
    for_s: float = 0.0  # how long it lasts
    share: float = 0.0  # of messages that it befalls

    def __str__(self) -> str:
        who = f" of {self.name}" if self.name else ""
        return f"{self.kind}{who} at {self.at_s:.3f} s (number {self.number}, {self.for_s:.3f} s, {self.share:.2f})"


@dataclass(frozen=True)
class Proposal:
    """A change that is asked for at a time."""

    key: str
    at_s: float
    change: Change
    alone: bool = False  # whether the nodes that are new in it fail alone, and are detached where they are lost

    @property
    def new_nodes(self) -> list[str]:
        return sorted(new_nodes(self.change))

    @property
    def on_loss(self) -> Mapping[str, str]:
        return dict.fromkeys(self.new_nodes, "detach") if self.alone else {}

    def word(self) -> Propose:
        rejoin_s = dict.fromkeys(self.on_loss, REJOIN_S)
        return Propose(self.key, self.change.plain(), dict(self.on_loss), rejoin_s, tuple(self.on_loss))


@dataclass(frozen=True)
class Scenario:
    """All that is decided before a simulation begins."""

    seed: int  # of the delays, too
    roster: Roster  # at the beginning
    epochs: int  # how many
    faults: tuple[Fault, ...] = ()  # in any order
    proposals: tuple[Proposal, ...] = ()  # likewise
    together: bool = True  # whether all processes are there when the run begins, their links open; else they join
    on_uncertain_act: str = "repeat"  # of the world
    on_loss: Mapping[str, str] = field(default_factory=dict)  # by node
    rejoin_timeout_s: Mapping[str, float] = field(default_factory=dict)  # likewise
    left_dead: frozenset[str] = frozenset()  # nodes whose processes are not started again
    trials_fail: bool = False  # whether whatever replaces a node raises in its first epoch
    # How long an epoch may take before it is asked who waits for whom; None: for ever, so that nothing but what befalls
    # the run itself can make it go on.
    epoch_deadline_s: float | None = 0.3

    @property
    def rated(self) -> bool:
        """Whether nodes have rates: then no node fails alone."""
        return self.roster.timing is not None

    @property
    def ends_itself(self) -> bool:
        """Whether the world finishes by itself, so that with rates the last epoch is no drained one."""
        return "last" in self.roster.nodes[self.roster.world].parameters

    @property
    def alone(self) -> tuple[str, ...]:
        return tuple(sorted(self.on_loss.keys() & self.roster.nodes.keys()))

    @property
    def last_s(self) -> float:
        ends = [fault.at_s + fault.for_s for fault in self.faults] + [each.at_s for each in self.proposals]
        return max(ends, default=0.0)


def draw_scenario(seed: int, faults: Collection[str] = FAULTS, epochs: int | None = None) -> Scenario:
    """The scenario of a seed, with these kinds of faults; a number of epochs of None is for the seed to decide."""
    rng = Random(f"{seed}/scenario")
    roster = _roster(rng)
    count = rng.randint(5, 14) if epochs is None else epochs
    span_s = count * EPOCH_S
    proposals = _proposals(rng, roster, span_s)
    names = sorted(set(roster.nodes) - {WORLD_NAME}) + [p for p in NAMES[:3] if p not in roster.nodes]
    detached = frozenset(name for name in names if rng.random() < 0.2)
    apart = (BREAK, TRIAL, *_SHARES)
    befalls = _faults(rng, tuple(kind for kind in FAULTS if kind in faults and kind not in apart), names, span_s)
    if BREAK in faults:
        befalls += _breaks(Random(f"{seed}/breaks"), [*names, WORLD_NAME], span_s, only=len(faults) == 1)
    for kind in (kind for kind in _SHARES if kind in faults):
        drawn = Random(f"{seed}/{kind}")
        if drawn.random() < _SHARES[kind]:
            befalls += (_fault(drawn, kind, names, 0.7 * span_s),)
    return Scenario(
        seed,
        roster,
        count,
        befalls,
        proposals,
        together=rng.random() < 0.5,
        on_uncertain_act=rng.choice(("repeat", "skip")),
        on_loss=dict.fromkeys(sorted(detached), "detach"),
        rejoin_timeout_s={name: rng.choice((0.05, 0.5, 5.0)) for name in names},
        left_dead=frozenset(name for name in sorted(detached) if rng.random() < 0.3),
        epoch_deadline_s=0.3 if not befalls or _NEED_DEADLINE & {fault.kind for fault in befalls} else None,
        trials_fail=TRIAL in faults and Random(f"{seed}/trials").random() < (0.7 if len(faults) == 1 else 0.3),
    )


def _roster(rng: Random) -> Roster:
    count = rng.randint(2, 6)
    names = [WORLD_NAME, *rng.sample(NAMES, count - 1)]
    world = rng.choice(("MixingWorld", "ActingWorld"))
    nodes = {WORLD_NAME: Reference(f"{MODULE}:{world}", {"name": WORLD_NAME, "policies": 2})}
    nodes.update({name: _node(rng, name, 0) for name in names[1:]})
    density = rng.choice((0.0, 0.3, 0.7))
    pairs: list[Pair] = []
    for place in range(1, count):
        needed = rng.randrange(place)
        pairs += [(names[low], names[place]) for low in range(place) if low == needed or rng.random() < density]
    return Roster(WORLD_NAME, nodes, tuple(_edge(rng, *pair) for pair in sorted(pairs)))


def _node(rng: Random, name: str, generation: int) -> Reference:
    parameters = {"name": name, "policies": rng.randint(1, 3), "generation": generation}
    return Reference(f"{MODULE}:{rng.choice(('Mixer', 'Mixer', 'Drawer'))}", parameters)


def _edge(rng: Random, lower: str, upper: str) -> RosterEdge:
    sense, task, context = (
        None if target is None else Reference(f"{MODULE}:{target}", {"name": f"{lower}-{upper}-{kind}"})
        for kind in FUNCTIONS
        for target in [rng.choice((None, "Mix", "Mix", "DrawingMix"))]
    )
    return RosterEdge(lower, upper, sense, task, context)


def _proposals(rng: Random, roster: Roster, span_s: float) -> tuple[Proposal, ...]:
    """Changes; whether one can be done depends on those before it, and some cannot."""
    proposals = []
    there = sorted(roster.nodes)
    for number in range(rng.choice((0, 0, 1, 1, 2, 3))):
        change = draw_change(rng, there, number + 1)
        if isinstance(change, Attach):
            there = sorted({*there, *change.nodes})
        alone = isinstance(change, Attach) and rng.random() < 0.7
        proposals.append(Proposal(f"c{number + 1}", rng.uniform(0.0, 0.6 * span_s), change, alone))
    return tuple(proposals)


def draw_change(rng: Random, there: list[str], generation: int) -> Change:
    """A change of a hierarchy that has these nodes; whether it can be made is not looked at."""
    kind = rng.choice(("attach", "attach", "detach", "replace", "replace"))
    others = [name for name in there if name != WORLD_NAME]
    if kind == "attach" or not others:
        free = [name for name in NAMES if name not in there] or [NAMES[0]]
        name = rng.choice((rng.choice(free), rng.choice(NAMES[:3])))
        pairs = [(lower, name) for lower in there if lower != name and rng.random() < 0.3]
        pairs = pairs or [(WORLD_NAME, name)]
        if rng.random() < 0.3:
            pairs += [(name, upper) for upper in others if upper != name and (upper, name) not in pairs][:1]
        return Attach({name: _node(rng, name, generation)}, tuple(_edge(rng, *pair) for pair in pairs))
    name = rng.choice(others)
    if kind == "detach":
        return Detach(name, cascade=rng.random() < 0.7)
    return Replace(name, _node(rng, name, generation))


def _faults(rng: Random, kinds: tuple[str, ...], names: list[str], span_s: float) -> tuple[Fault, ...]:
    if not kinds:
        return ()
    count = rng.choice((0, 1, 1, 2, 2, 3, 4, 6))
    return tuple(_fault(rng, rng.choice(kinds), names, span_s) for _ in range(count))


def _breaks(rng: Random, names: list[str], span_s: float, only: bool) -> tuple[Fault, ...]:
    count = rng.choice((1, 2, 4)) if only else rng.choice((0, 0, 0, 0, 1, 3))
    return tuple(
        Fault(BREAK, rng.uniform(0.0, span_s), rng.choice(names), rng.randrange(6), rng.choice((0.002, 0.05, 0.5)))
        for _ in range(count)
    )


def _fault(rng: Random, kind: str, names: list[str], span_s: float) -> Fault:
    at_s = rng.uniform(0.0, span_s)
    name = WORLD_NAME if rng.random() < _OF_WORLD.get(kind, 0.0) else rng.choice(names)
    if kind in (CRASH, WORLD, TORN, DAMAGE, RAISE, *FORGED):
        return Fault(kind, at_s, name, rng.randint(1, 25))
    if kind in OF_MESSAGES:
        return Fault(kind, at_s, for_s=rng.uniform(0.01, 0.3), share=rng.choice((0.05, 0.3, 0.8)))
    if kind == PARTITION:
        return Fault(kind, at_s, name, rng.randrange(2), rng.choice((0.05, 0.5, 3.0)))
    if kind in (HANG, PAUSE):
        return Fault(kind, at_s, name, 0, rng.choice((0.05, 0.5, 3.0)))
    return Fault(kind, at_s, name, 0, rng.uniform(0.1, 1.0), rng.uniform(0.001, 0.02))
