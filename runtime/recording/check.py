"""Whether what was recorded keeps to the formal order: a checker that shares nothing with the engine.

It looks at what went in and out at the nodes' ports, in the order in which each port saw
it, and at the messages and digests themselves:

    EDGE     a message runs along an edge of its roster, from the process that the roster names:
             observations upward, context downward, tasks downward where there is a task function
    ONCE     of an edge and kind there is one message in an attempt (said again, it is the same)
    SENSE    a node sends observations after it has those of every child
    UP       a node sends nothing down before it has sent its observations to every parent
    PREDICT  a node sends nothing down before it has tasks, and no context before it has context, of every parent
    ALL      a node that has done an epoch has sent all that its roster wants of it
    EPOCH    inputs are of the epoch itself; with a staleness, of one that may be used
    TIME     all messages of an attempt have the same time
    COMMIT   epochs are committed once and in order, and nothing of an epoch follows its commit
    DIGEST   a node's digest is that of its state and its parents' digests, the run's the chain of the world's
    GRAPH    a roster is a hierarchy
    TURN     with rates, a node takes part in its turns, in each of them, and in no other epoch

With rates ALL, SENSE and UP hold of every epoch of which a node is told, PREDICT and DIGEST of what is in force in its
turn, and EPOCH of that and of what it has gathered.

"Before" and "after" are as the node's own port saw them: nothing that comes over a network
says in which order two others acted, but what one has received another has sent before."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple
from zlib import crc32

from hierax.runtime.core.digest import NO_DIGEST, epoch_digest, node_digest
from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import check_graph
from hierax.runtime.core.staleness import BARRIER, Staleness
from hierax.runtime.recording.rated_order import RatedTurn, previous_turn
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.topics import MESSAGE, ROSTER, STEP, glance
from hierax.runtime.recording.trace import Attempt, Line
from hierax.schemas.messages import CONTEXT, GREETING, OBSERVATIONS, TASKS, Header
from hierax.schemas.rates import Rates
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep, Passage

KEPT_EPOCHS = 64  # how many epochs back what a port saw is remembered
SETTLED_EPOCHS = 4096
SETTLED_BYTES = 64 << 20
"""So many commits, or so much, later everything of an epoch is here: links may be far behind each other."""

SHOWN = 100
_NO_ELEMENTS = b"\x90"  # the payload of a message that holds nothing
HELD_STEPS = 10_000  # how many steps may wait for their roster


class Violation(NamedTuple):
    """Where the formal order is broken: the rule, as listed above, when, and who did what."""

    rule: str
    epoch: int
    attempt: int
    what: str

    def __str__(self) -> str:
        return f"{self.rule}: epoch {self.epoch}, attempt {self.attempt}: {self.what}"


class Turns(NamedTuple):
    """How far a node with rates has come."""

    steps: int  # in how many epochs it took part
    last: int  # the last one
    in_force: Mapping[str, int]  # by upper neighbour, the epoch whose context counted in that; 0: there was none yet


@dataclass
class _Seat:
    """A node's place under a version of the roster: what it has to hear and to say."""

    below: Sequence[str]
    above: Sequence[str]
    to_above: Sequence[tuple[str, str]]
    from_above: Sequence[tuple[str, str]]
    to_below: Sequence[tuple[str, str]]


@dataclass
class _PortLog:
    """What a node's port saw, by its own words, in order."""

    stream: str
    number: int
    unsure: int
    told: int = 0  # the epoch of the last step; 0: none by this process
    after: int = 0  # with rates: up to this epoch its port saw things before anybody recorded; 0: it did not
    seen: dict[Passage, int] = field(default_factory=dict)
    count: int = 0

    def add(self, passages: Iterable[Passage], epoch: int, kept: int) -> None:
        """Of so many epochs up to this one what was seen is kept, at least."""
        for passage in passages:
            self.count += 1
            self.seen.setdefault(passage, self.count)
        if len(self.seen) > 64 * kept:
            self.seen = {each: at for each, at in self.seen.items() if each.epoch > epoch - kept}

    def place(self, sent: bool, kind: str, peer: str, when: Attempt) -> int | None:
        return self.seen.get(Passage(sent, kind, peer, *when))

    def place_of(self, sent: bool, kind: str, peer: str, epoch: int) -> int | None:
        """With rates, where an epoch has one attempt."""
        return self.place(sent, kind, peer, (epoch, 0))


class Checker:
    """Sees all that is recorded of a run of this staleness, as it comes, from the run's start or not, and says what
    breaks the order."""

    def __init__(self, staleness: Staleness = BARRIER, from_start: bool = True) -> None:
        self.violations: list[Violation] = []  # the first ones
        self.epochs = self.checked = 0  # how many commits were seen, and steps checked
        self.turns: dict[str, Turns] = {}  # by node, with rates
        self._staleness = staleness
        self._from_start = from_start
        self._kept = KEPT_EPOCHS  # and, with rates, as far back as something may be of that counts, by any roster
        self._rosters: dict[int, Roster] = {}
        self._seats: dict[tuple[int, str], _Seat] = {}
        self._logs: dict[str, _PortLog] = {}
        self._messages: dict[Attempt, dict[Line, tuple[int, bytes, bool]]] = {}  # in the order in which they began
        self._times: dict[Attempt, float] = {}
        self._waiting: deque[NodeStep] = deque()
        self._bytes = 0
        self._held: list[Header] = []
        self._early: deque[NodeStep] = deque()
        self._committed: tuple[int, int, bytes] = (0, 0, b"")

    def roster(self, roster: Roster) -> None:
        if roster.version in self._rosters:
            return
        self._rosters[roster.version] = roster
        if roster.rates is not None:
            self._kept = max(self._kept, KEPT_EPOCHS + roster.rates.reach)
        try:
            check_graph(roster.world, roster.nodes, roster.pairs)
        except HierarchyError as error:
            self._break("GRAPH", (self._committed[0] + 1, 0), f"roster version {roster.version}: {error}")
        held, self._held = self._held, []
        for header in held:
            self._check_edge(header)
        early, self._early = self._early, deque()
        for step in early:
            self.step(step)

    def message(self, data: bytes) -> None:
        """A message along an edge."""
        header, payload_at = glance(data)
        if header.epoch == GREETING:
            return
        when, what = header.when, _in_words(header)
        known = self._messages.setdefault(when, {})
        content = crc32(memoryview(data)[payload_at:])  # what is in the extensions may change
        before = known.get(header.line)
        if before is None:
            known[header.line] = (content, header.digest, data[payload_at : payload_at + 1] == _NO_ELEMENTS)
            self._check_edge(header)
        elif before[:2] != (content, header.digest):
            self._break("ONCE", when, f"{what} was sent twice, unlike")
        time_s = self._times.setdefault(when, header.time_s)
        if time_s != header.time_s:
            self._break("TIME", when, f"{header.sender} says it is {header.time_s} s, another one {time_s} s")
        epoch, attempt, _ = self._committed
        if self._staleness.barrier and header.epoch == epoch and header.attempt > attempt:
            self._break("COMMIT", when, f"{what} after its commit")

    def step(self, step: NodeStep) -> None:
        if self._early or step.roster > max(self._rosters, default=-1):
            self._early.append(step)  # its roster comes along another link
            if len(self._early) > HELD_STEPS:
                self._logs.pop(self._early.popleft().name, None)
            return
        roster = self._rosters.get(step.roster)
        rates = None if roster is None else roster.rates
        log = self._log(step, rates)
        log.add(step.passages, step.epoch, self._kept)
        if roster is None:
            return  # of before the recording
        self._waiting.append(step)
        self._bytes += len(step.state)
        if rates is not None:
            self._check_turn(step, log, roster)
        elif not log.unsure:
            self._check_order(step, log, self._seat(roster, step.name))
        log.unsure = max(log.unsure - 1, 0)
        log.told = step.epoch
        if step.name == roster.world:
            self._commit(step, roster)
            settled = step.epoch - SETTLED_EPOCHS
            while self._waiting and (self._waiting[0].epoch <= settled or self._bytes > SETTLED_BYTES):
                self._check_digest(self._waiting.popleft())
            settled -= 0 if rates is None else rates.reach
            while (oldest := next(iter(self._messages), None)) is not None and oldest[0] < settled:
                del self._messages[oldest], self._times[oldest]

    def close(self) -> Sequence[Violation]:
        """What was found, the first ones; after the end."""
        while self._waiting:
            self._check_digest(self._waiting.popleft())
        return self.violations

    # --- the rules

    def _check_edge(self, header: Header) -> None:
        roster = self._rosters.get(header.roster)
        if roster is None:
            if len(self._held) < SHOWN:
                self._held.append(header)  # it is told a little later than the first messages under it go
            return
        upward = header.kind == OBSERVATIONS
        pair = (header.sender, header.receiver) if upward else (header.receiver, header.sender)
        edge = next((edge for edge in roster.edges if edge.pair == pair), None)
        what, named = _in_words(header), roster.instance(header.sender)
        if edge is None:
            self._break("EDGE", header.when, f"{what}: version {header.roster} has no such edge")
        elif header.kind == TASKS and edge.task is None:
            self._break("EDGE", header.when, f"{what}: the edge has no task function")
        elif header.instance != named:
            self._break("EDGE", header.when, f"{what}: from instance {header.instance}, the roster names {named}")

    def _check_order(self, step: NodeStep, log: _PortLog, seat: _Seat) -> None:
        self.checked += 1
        when = step.when
        sent = {line: log.place(True, *line, when) for line in (*seat.to_above, *seat.to_below)}
        lacking = [f"{kind} to {peer}" for (kind, peer), at in sent.items() if at is None]
        if lacking:
            self._break("ALL", when, f"{step.name} has not sent {', '.join(lacking)}")
        ups = [at for line in seat.to_above if (at := sent[line]) is not None]
        first_up, last_up = min(ups, default=inf), max(ups, default=0)
        downs = [(kind, at) for kind, peer in seat.to_below if (at := sent[kind, peer]) is not None]
        first_down = min((at for _, at in downs), default=inf)
        first_context = min((at for kind, at in downs if kind == CONTEXT), default=inf)
        if first_down < last_up:
            self._break("UP", when, f"{step.name} sent something down before its observations had all gone up")
        used = self._used(step, when)
        for peer in seat.below:
            received = log.place(False, OBSERVATIONS, peer, used.get((peer, OBSERVATIONS), when))
            if received is None or received > first_up:
                self._break("SENSE", when, f"{step.name} sent observations without those of {peer}")
        for kind, peer in seat.from_above:
            received = log.place(False, kind, peer, used.get((peer, kind), when))
            if received is None or received > (first_down if kind == TASKS else first_context):
                self._break("PREDICT", when, f"{step.name} predicted without {kind} of {peer}")

    def _check_turn(self, step: NodeStep, log: _PortLog, roster: Roster) -> None:
        """With rates."""
        turn = RatedTurn(step, roster, previous_turn(self._rosters, step))
        faults = [*turn.turn_faults(log.told), *turn.input_faults()]
        steps = self.turns[step.name].steps if step.name in self.turns else 0
        self.turns[step.name] = Turns(steps + 1, step.epoch, dict(turn.contexts()))
        if step.epoch > log.after:
            self.checked += 1
            epochs = turn.passed() if log.told else (step.epoch,)  # another process may have passed those before
            faults += turn.order_faults(log.place_of, epochs, log.after)
        for rule, what in faults:
            self._break(rule, step.when, what)

    def _used(self, step: NodeStep, when: Attempt) -> dict[tuple[str, str], Attempt]:
        """The epochs that the inputs were of, which are found fault with where they may not be."""
        used = step.used_of
        bound = self._staleness.epochs
        for (peer, kind), (epoch, _) in used.items():
            age = step.epoch - epoch
            oldest = 0 if bound == 0 or (kind == OBSERVATIONS and bound is not None) else bound
            if age < 0 or (oldest is not None and age > oldest):
                self._break("EPOCH", when, f"{step.name} used {kind} of {peer} of epoch {epoch}")
        return used

    def _commit(self, step: NodeStep, roster: Roster) -> None:
        epoch, attempt, chain = self._committed
        when = step.when
        if step.epoch == epoch and step.attempt != attempt:
            self._break("COMMIT", when, f"epoch {epoch} was committed before, as attempt {attempt}")
        elif 0 < step.epoch < epoch:
            self._break("COMMIT", when, f"epoch {epoch} was committed before")
        if chain and step.chain and step.epoch == epoch + 1:
            expected = epoch_digest(chain, step.epoch, roster.content_hash(), step.digest)
            if expected != step.chain:
                self._break("DIGEST", when, "the run's digest does not follow from the last one and the world's")
        self._committed = (*when, step.chain)
        self.epochs += 1

    def _check_digest(self, step: NodeStep) -> None:
        self._bytes -= len(step.state)
        roster = self._rosters.get(step.roster)
        if roster is None:
            return
        if roster.rates is not None:
            self._check_rated_digest(step, roster)
            return
        used, digests = step.used_of, []
        for peer in self._seat(roster, step.name).above:
            heard = self._messages.get(used.get((peer, CONTEXT), step.when), {}).get((CONTEXT, peer, step.name))
            if heard is None:
                return  # not recorded: a gap, which is told elsewhere
            digests.append(heard[1])
        self._compare_digest(step, digests, "this epoch")

    def _check_rated_digest(self, step: NodeStep, roster: Roster) -> None:
        turn = RatedTurn(step, roster, previous_turn(self._rosters, step))
        for rule, what in turn.gathering_faults(self._said):
            self._break(rule, step.when, what)
        heard = [
            (0, NO_DIGEST, True) if epoch == 0 else self._said(CONTEXT, upper, step.name, epoch)
            for upper, epoch in turn.contexts()
        ]
        digests = [message[1] for message in heard if message is not None]
        if len(digests) == len(heard):
            self._compare_digest(step, digests, "the epochs in force")

    def _said(self, kind: str, sender: str, receiver: str, epoch: int) -> tuple[int, bytes, bool] | None:
        return self._messages.get((epoch, 0), {}).get((kind, sender, receiver))

    def _compare_digest(self, step: NodeStep, above: Sequence[bytes], when: str) -> None:
        if node_digest(step.state, above) != step.digest:
            what = f"{step.name}'s digest does not follow from its state and the context of {when}"
            self._break("DIGEST", step.when, what)

    # --- helpers

    def _log(self, step: NodeStep, rates: Rates | None) -> _PortLog:
        known = self._logs.get(step.name)
        if known is not None and known.stream == step.stream and step.number == known.number + 1:
            known.number += 1
            return known
        roster = self._rosters.get(min(self._rosters, default=-1))
        joined = roster is not None and step.name in roster.nodes and known is None and step.epoch > 1
        unsure = 0
        if joined or step.number != 1:  # its port saw things before anybody recorded
            unsure = 1 if self._staleness.barrier else KEPT_EPOCHS
        self._logs[step.name] = log = _PortLog(step.stream, step.number, unsure)
        if rates is not None:
            log.after = step.epoch if step.number != 1 or (joined and not self._from_start) else 0
        return log

    def _seat(self, roster: Roster, name: str) -> _Seat:
        key = (roster.version, name)
        if key not in self._seats:
            below, above, tasks = roster.below(name), roster.above(name), roster.tasking
            to_above, from_above = ([(kind, peer) for peer in above] for kind in (OBSERVATIONS, CONTEXT))
            from_above += [(TASKS, peer) for peer in above if (name, peer) in tasks]
            to_below = [(CONTEXT, peer) for peer in below] + [(TASKS, peer) for peer in below if (peer, name) in tasks]
            self._seats[key] = _Seat(below, above, to_above, from_above, to_below)
        return self._seats[key]

    def _break(self, rule: str, when: Attempt, what: str) -> None:
        if len(self.violations) < SHOWN:
            self.violations.append(Violation(rule, *when, what))


def _in_words(header: Header) -> str:
    return f"{header.kind} {header.sender} -> {header.receiver}"


def check_recording(recording: Recording) -> Checker:
    """A checker that has seen all of a recording. Raises `RecordingError` if the recording is damaged."""
    checker = Checker(recording.info.how_stale, recording.info.from_start)
    for entry in recording.entries(MESSAGE, STEP, ROSTER):
        if entry.topic.what == MESSAGE:
            checker.message(entry.data)
        elif entry.topic.what == STEP:
            checker.step(entry.step())
        else:
            checker.roster(entry.roster())
    return checker
