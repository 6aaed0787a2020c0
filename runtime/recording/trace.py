"""Traces: what happened in each epoch, put together from what was heard in any order."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.graph import check_graph, topological_order
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.recording.topics import EPOCH, MESSAGE, ROSTER, Entry, glance
from hierax.schemas.checkpoint import decode_state
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, GREETING, OBSERVATIONS, TASKS, Message, decode_message
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep
from hierax.schemas.values import decode_value

PENDING_BYTES = 256 << 20
PENDING_EPOCHS = 20_000
"""So much is kept while a node that has not told of an epoch may still do so: links may be far behind each other. With
more, an epoch is given without what that node did, and older ones of which the world has told nothing are dropped."""

Attempt = tuple[int, int]  # an epoch and which attempt of it
Line = tuple[str, str, str]  # kind, sender and receiver


@dataclass(frozen=True)
class NodeTrace:
    """What a node told that it did in an epoch; values are decoded, or a `SchemaError`, when they are asked for."""

    step: NodeStep
    place: str = ""

    @cached_property
    def state(self) -> ActiveNode:
        """Belief, policy and actions after it."""
        return ActiveNode(*decode_state(self.step.state, self._where("state")))

    @cached_property
    def start(self) -> ActiveNode | None:
        """The state at its beginning, where that was told."""
        return ActiveNode(*decode_state(self.step.start, self._where("start"))) if self.step.start else None

    @cached_property
    def sensed(self) -> tuple[Value] | None:
        """The belief after `observe`, in a tuple; None: it was not told."""
        return (decode_value(self.step.sensed, self._where("sensed")),) if self.step.sensed else None

    def _where(self, what: str) -> str:
        return f"{self.place}: epoch {self.step.epoch}: {self.step.name}: {what}"


@dataclass
class EpochTrace:
    """A committed epoch."""

    epoch: int
    attempt: int  # the one that was committed
    roster: Roster  # under which it was done
    nodes: Mapping[str, NodeTrace]  # that told, by name: others died first, or, where epochs overlap, left it out
    lines: Mapping[Line, Mapping[int, bytes]] = field(repr=False)  # messages by attempt
    digest: bytes  # of the run; empty: not told
    heard_ns: int = 0  # when the world told of it, since 1970; 0: it did not
    previous: bytes = b""  # digest, after the epoch before
    place: str = ""  # of the recording, for errors: `SchemaError` where a message is none
    begun: Mapping[str, NodeTrace] = field(default_factory=dict)  # with rates: states of who came, and has a later turn

    def message(self, data: bytes) -> Message:
        try:
            return decode_message(data)
        except SchemaError as error:
            raise SchemaError(error.what, f"{self.place}: epoch {self.epoch}: {error.where}") from error

    @property
    def time_s(self) -> float | None:
        """The time of the epoch; None: nobody told."""
        for trace in self.nodes.values():
            return trace.step.time_s
        for attempts in self.lines.values():
            if self.attempt in attempts:
                return self.message(attempts[self.attempt]).header.time_s
        return None

    @cached_property
    def order(self) -> tuple[str, ...]:
        """The nodes from below to above."""
        return order_of(self.roster)

    def elements(self, kind: str, sender: str, receiver: str) -> Elements | None:
        """What a message of the attempt that was committed held; None: it was not recorded."""
        data = self.lines.get((kind, sender, receiver), {}).get(self.attempt)
        return None if data is None else self.message(data).payload

    def start_of(self, name: str) -> ActiveNode | None:
        """A node's state at its beginning, where that was told."""
        if name in self.begun:
            return self.begun[name].state
        return self.nodes[name].start if name in self.nodes else None

    def used_of(self, name: str) -> Mapping[tuple[str, str], tuple[int, int]] | None:
        """The epoch and attempt of a node's inputs, by sender and kind; None: they were of this one."""
        return (self.nodes[name].step.used_of or None) if name in self.nodes else None

    def sensed_of(self, name: str) -> tuple[Value] | None:
        """A node's belief after `observe`, in a tuple; None: not told."""
        return self.nodes[name].sensed if name in self.nodes else None

    def state_of(self, name: str) -> ActiveNode | None:
        """A node's state after it; None: not told."""
        return self.nodes[name].state if name in self.nodes else None

    @cached_property
    def lacking(self) -> tuple[str, ...]:
        """What an epoch has that does not overlap others, or by the rates, and this one lacks, in words."""
        doing = taking_part(self.roster, self.epoch)
        lacking = [f"step of {name}" for name in doing if name not in self.nodes]
        unheard = [line for line in lines_of(self.roster, self.epoch) if self.attempt not in self.lines.get(line, {})]
        return (*lacking, *(f"{kind} message {sender} -> {receiver}" for kind, sender, receiver in unheard))


def taking_part(roster: Roster, epoch: int) -> tuple[str, ...]:
    """The nodes of a roster that take part in an epoch, by name."""
    rates = roster.rates
    return tuple(name for name in sorted(roster.nodes) if rates is None or rates.takes_part(name, epoch))


def lines_of(roster: Roster, epoch: int) -> list[Line]:
    """Along which lines something is said in an epoch in any case; in a drained one it is along more."""
    lines: list[Line] = []
    rates, doing = roster.rates, taking_part(roster, epoch)
    for lower, upper, task in ((edge.lower, edge.upper, edge.task) for edge in roster.edges):
        if rates is None or rates.is_told(upper, epoch):
            lines.append((OBSERVATIONS, lower, upper))
        if upper in doing:
            lines.append((CONTEXT, upper, lower))
            lines += [] if task is None else [(TASKS, upper, lower)]
    return lines


def order_of(roster: Roster) -> tuple[str, ...]:
    """The nodes of a roster from below to above, ties by name."""
    return topological_order(roster.nodes, roster.pairs)


@dataclass
class _Pending:
    """An epoch that is being put together."""

    steps: dict[str, dict[int, NodeStep]] = field(default_factory=dict)
    lines: dict[Line, dict[int, bytes]] = field(default_factory=dict)
    digest: bytes = b""
    heard_ns: int = 0
    size: int = 0


def check_roster(roster: Roster) -> Roster:
    """A roster that is a hierarchy, as it is. Raises `HierarchyError` if it is none."""
    check_graph(roster.world, roster.nodes, roster.pairs)
    return roster


class Assembly:
    """Puts epochs of a run together, in order, from entries as they were heard, in a recording's place for errors."""

    def __init__(self, staleness: Staleness, place: str = "") -> None:
        self._barrier = staleness.barrier
        self._place = place
        self._pending: dict[int, _Pending] = {}
        self._rosters: dict[int, Roster] = {}
        self._told: dict[str, tuple[int, int]] = {}
        self._bytes = 0
        self._world = 0  # the last epoch of which the world has told
        self._next = 0
        self._digest = (0, NO_DIGEST)
        self._instances: Mapping[str, int] | None = None  # of the last roster under which an epoch was done

    def take(self, entry: Entry) -> bool:
        """Take something in; whether epochs may be whole now. Raises `SchemaError` or `HierarchyError` if it is bad."""
        what = entry.topic.what
        if what == ROSTER:
            roster = check_roster(entry.roster())
            self._rosters.setdefault(roster.version, roster)
            return False
        if what == MESSAGE:
            seen, _ = glance(entry.data)
            if seen.epoch == GREETING:
                return False
            pending = self._at(seen.epoch, len(entry.data))
            pending.lines.setdefault(seen.line, {})[seen.attempt] = entry.data
            return self._is_full
        if what == EPOCH:
            epoch, digest = entry.commit()
            self._at(epoch).digest = digest
            return self._is_full
        step = entry.step()
        self._at(step.epoch, len(entry.data)).steps.setdefault(step.name, {})[step.attempt] = step
        self._told[step.name] = max(step.when, self._told.get(step.name, (0, 0)))
        under = self._rosters.get(step.roster)
        if under is not None and step.name == under.world:
            self._world = max(self._world, step.epoch)
            self._at(step.epoch).heard_ns = entry.time_ns
            self._next = self._next or min(self._pending)
        return True

    def ripe(self, at_end: bool = False) -> Iterator[EpochTrace]:
        """The committed epochs of which nothing more comes."""
        while self._next and self._next <= self._world:
            pending = self._pending.get(self._next)
            if pending is None:  # nothing was told of it, nor perhaps of many that follow
                self._next = min((epoch for epoch in self._pending if epoch > self._next), default=self._world + 1)
                continue
            if not (at_end or self._is_ripe(pending)):
                return
            del self._pending[self._next]
            self._bytes -= pending.size
            self._next += 1
            trace = self._trace(self._next - 1, pending)
            self._digest = (self._next - 1, pending.digest if trace is None else trace.digest)
            if trace is not None:
                yield trace
        if self._is_full and not at_end:
            self._drop()

    @property
    def _is_full(self) -> bool:
        return self._bytes > PENDING_BYTES or len(self._pending) > PENDING_EPOCHS

    def _drop(self) -> None:
        """Drop the older half of the epochs of which the world has told nothing: perhaps it never will. One that it has
        just done, and the one that follows, stay, however large they are."""
        epochs = sorted(self._pending)
        for epoch in epochs[: (len(epochs) - 1) // 2]:
            self._bytes -= self._pending.pop(epoch).size

    def _is_ripe(self, pending: _Pending) -> bool:
        if self._is_full or self._world >= self._next + PENDING_EPOCHS:
            return True
        roster = self._roster(pending)
        if roster is None:
            return True  # of before the recording
        attempts = pending.steps.get(roster.world)
        # with its commit untold, nobody knows which attempt is the last one until the next epoch is told of
        done = (self._next, max(attempts)) if attempts else (self._next + 1, 0)
        doing = taking_part(roster, self._next)
        if roster.rates is not None and any(line not in pending.lines for line in lines_of(roster, self._next)):
            done = (roster.rates.reach + self._next, 0)  # nobody says anything of this epoch any more
            doing = tuple(roster.nodes)
        coming = self._coming(roster, self._next)
        is_there = all(self._told.get(name, (0, 0)) >= (turn, 0) for name, turn in coming.items())
        return is_there and all(self._told.get(name, (0, 0)) >= done for name in doing)

    def _coming(self, roster: Roster, epoch: int) -> Mapping[str, int]:
        """With rates: the nodes that have another process than before, and the later turns in which these tell it."""
        rates, before = roster.rates, self._instances
        if rates is None or before is None or before == roster.instances:
            return {}
        others = [name for name in roster.nodes if roster.instance(name) != before.get(name, 0)]
        return {name: rates.next_turn(name, epoch) for name in others if not rates.takes_part(name, epoch)}

    def _roster(self, pending: _Pending) -> Roster | None:
        versions = [step.roster for steps in pending.steps.values() for step in steps.values()]
        known = [self._rosters[version] for version in sorted(versions) if version in self._rosters]
        return known[-1] if known else None

    def _trace(self, epoch: int, pending: _Pending) -> EpochTrace | None:
        roster = self._roster(pending)
        if roster is None:
            return None  # of before the recording
        world = pending.steps.get(roster.world)
        attempt = max(world) if world else max(each for steps in pending.steps.values() for each in steps)
        nodes = {}
        for name, steps in sorted(pending.steps.items()):
            step = steps.get(attempt) if self._barrier else steps[max(steps)]
            if step is not None and name in roster.nodes:
                nodes[name] = NodeTrace(step, self._place)
        one = next((trace.step for trace in nodes.values()), None)
        for name in [name for name in taking_part(roster, epoch) if name not in nodes]:
            later = self._state_from(name, epoch + 1 if roster.rates is None else roster.rates.next_turn(name, epoch))
            if later is not None and one is not None and self._barrier:
                taken = later._replace(epoch=epoch, attempt=attempt, roster=roster.version, time_s=one.time_s)
                nodes[name] = NodeTrace(taken, self._place)
        coming = {name: self._state_from(name, turn) for name, turn in self._coming(roster, epoch).items()}
        begun = {name: NodeTrace(step, self._place) for name, step in coming.items() if step is not None}
        self._instances = roster.instances
        digest = (world[attempt].chain if world else b"") or pending.digest
        previous = self._digest[1] if self._digest[0] == epoch - 1 else b""
        told = (pending.lines, digest, pending.heard_ns, previous, self._place, begun)
        return EpochTrace(epoch, attempt, roster, dict(sorted(nodes.items())), *told)

    def _state_from(self, name: str, epoch: int) -> NodeStep | None:
        """What the next process of a node that died before it could tell began the next epoch with."""
        following = self._pending.get(epoch)
        for step in following.steps.get(name, {}).values() if following is not None else ():
            if step.start:
                return step._replace(state=step.start, sensed=b"", start=b"", digest=b"", passages=(), chain=b"")
        return None

    def _at(self, epoch: int, size: int = 0) -> _Pending:
        """What is known of an epoch, of which there are so many bytes more."""
        if epoch < self._next:
            return _Pending()  # it comes too late
        pending = self._pending.setdefault(epoch, _Pending())
        pending.size += size
        self._bytes += size
        return pending
