"""A simulated process: production code, and an end at any of its calls."""

from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from random import Random
from typing import Any, Protocol

from hierax.runtime.core.binding import Call
from hierax.runtime.core.errors import ContradictionError, OperatorError
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.table import ACTIONS, Action
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.sim.checker import Checker
from hierax.runtime.sim.inspection import Inspected, Inspector, Turn, forged, inspected_edges
from hierax.runtime.sim.journal import FAULT, MESSAGE, VERDICT, Journal, control_kind
from hierax.runtime.sim.network import Clock, Crash, Host, Network, SimStorage
from hierax.runtime.sim.rated import Unlooked
from hierax.runtime.sim.scenario import CONTRADICT, FORETELL, RAISE, TORN, TRIAL, Scenario
from hierax.schemas.control import AskStatus, Control, Order, Prepare, decode_control
from hierax.schemas.messages import Header, Message, decode_message
from hierax.schemas.roster import Roster

TICK_S = 0.05  # how often a process looks after itself
CHECK_TICKS = 4  # every how many ticks it asks whether it is still wanted
REPLACED_DIES = 0.3  # how often what was replaced dies where what replaces it fails in its first epoch
FORGED_S = 0.02  # at most, how long after a message one comes that was made of it


@dataclass
class Surroundings:
    """What all simulated processes stand in."""

    scenario: Scenario
    clock: Clock
    journal: Journal
    checker: Checker
    network: Network
    processes: "dict[str, SimProcess]" = field(default_factory=dict)  # those that live, by token

    @property
    def world(self) -> "SimProcess | None":
        return next((process for process in self.processes.values() if process.is_world), None)

    @property
    def over(self) -> bool:
        """Whether the run is, as the world's process says."""
        world = self.world
        return world is not None and world.world is not None and world.world.over

    def states(self, turn: Turn) -> Mapping[str, bytes]:
        """The states that the processes in force have now; where an attempt was foretold, of those in this one."""
        engines = {
            process.name: process.engine
            for process in self.processes.values()
            if self.checker.process_of(turn.version, process.name) == process.token
        }
        return {
            name: engine.encoded
            for name, engine in engines.items()
            if not self.checker.foretold or (engine.epoch, engine.attempt) == turn[1:]
        }


class Attendant(Protocol):
    """Who notices how a process ends."""

    def died(self, process: "SimProcess") -> None:
        """It is dead, and another one may come in its place."""

    def exited(self, process: "SimProcess") -> None:
        """It was dismissed: it is not started again."""

    def stop(self, why: str) -> None:
        """The run cannot go on."""


class Owning(Protocol):
    """What the world's process runs beside its member."""

    def take_word(self, word: Control) -> None:
        """Somebody says something to the owner, or the owner to this process."""

    def tick(self) -> None:
        """Time has passed."""

    @property
    def over(self) -> bool:
        """Whether the run is."""


class SimProcess(Host):
    """One process of a node. `name, token`: of the node, and of the process alone."""

    def __init__(
        self, around: Surroundings, attendant: Attendant, name: str, token: str, request: str, storage: SimStorage
    ) -> None:
        super().__init__(name, token)
        self.request = request  # the change that the first process of its line was started for
        self.storage = storage  # of its checkpoints; its line's
        self.member: Member | None = None  # that it runs; None: the world's, before the run has begun here
        self.world: Owning | None = None  # of the world's process
        self.acting = 0  # the epoch of the world's act under way; 0: there is none
        self.alive = True
        self.calls_left = 0  # at which call it dies; 0: it doesn't
        self.torn = False  # whether it dies in its next write
        self.raises = False  # whether the next operator or edge function raises of a node that fails alone
        self.forges = ""  # what is made of the next message that it takes in, and comes after it; empty: nothing
        self.at = ""  # the last call that it made
        self.frozen = 0
        self.busy = False
        self.slowness_s = 0.0
        self._around = around  # what it stands in
        self._attendant = attendant  # told how it ends
        self._backlog: deque[tuple[str, Any]] = deque()
        self._ticks = 0
        self._place = self._finished = (0, 0)
        self._rng = Random(f"{around.scenario.seed}/{token}")
        self.is_world = name == around.scenario.roster.world
        checker = around.checker
        looks = Unlooked if around.scenario.rated else Inspector
        self.inspector = looks(name, token, checker.violate, checker.process_of, self._starts, self._calls)
        storage.tears = self._tears

    @property
    def runner(self) -> NodeRunner | None:
        return None if self.member is None else self.member.runner

    @property
    def engine(self) -> Engine:
        assert self.runner is not None
        return self.runner.engine

    def point(self, what: str) -> None:
        """A call to the outside, or the return of one: the process may die here."""
        self.at = what
        if self.calls_left:
            self.calls_left -= 1
            if not self.calls_left:
                raise Crash

    def run(self, what: Callable[[], None]) -> None:
        try:
            what()
        except Crash:
            self._attendant.died(self)
            return
        except ContradictionError as error:
            self._attendant.stop(str(error))
            return
        member = self.member
        if self.alive and member is not None and member.dismissed:
            self._around.journal.trace(f"{self.token} is dismissed: {member.dismissed}")
            if member.again:
                self.at = "dismissed"
                self._attendant.died(self)
            else:
                self._attendant.exited(self)

    def take(self, kind: str, data: Any) -> None:
        """Something comes in; handled now, or later where the process cannot."""
        if not self.alive:
            return
        if self.frozen:
            if self.busy and kind == "control" and self.member is not None:
                word = decode_control(data)
                if isinstance(word, AskStatus):
                    status = self.member.status(word.inquiry, busy="observe")
                    self.run(lambda: self.say(status))
                    return
            self._backlog.append((kind, data))
            return
        self.run(lambda: self._handle(kind, data))
        if self.slowness_s and kind == "message":
            self.freeze()
            self._around.clock.schedule(self.slowness_s, self.thaw)

    def freeze(self) -> None:
        """It handles nothing until it is thawed as often."""
        self.frozen += 1

    def thaw(self) -> None:
        self.frozen -= 1
        if not self.frozen:
            self.busy = False
        while self._backlog and not self.frozen and self.alive:
            self.take(*self._backlog.popleft())

    # --- what it says

    def say(self, word: Control) -> None:
        self.point(f"say {type(word).__name__}")
        world = self._around.world
        if world is not None:
            self._around.network.say(self.token, world.token, word)
        self.point("said")

    def send_order(self, token: str, order: Order) -> None:
        """The owner, which is in this process, says something to another one."""
        self.point(f"send {type(order).__name__}")
        self._around.journal.trace(f"owner sends {token} {_short(order)}")
        if isinstance(order, Prepare):
            self._around.checker.prepared(Roster.read(order.roster))
        self._around.network.say(self.token, token, order)
        self.point("sent")

    def publish(self, epoch: int, digest: bytes) -> None:
        self.point("publish")
        self._around.checker.publishes(epoch, digest)

    # --- what it is told

    def _handle(self, kind: str, data: Any) -> None:
        self._take(kind, data)
        if self.runner is not None:
            epoch, _ = place = (self.engine.epoch, self.engine.attempt)
            if epoch != self._place[0]:
                self._finished = self._place
            self._place = place

    def _take(self, kind: str, data: Any) -> None:
        if kind == "message":
            if self.runner is not None:
                self._step(self.runner, decode_message(data))
        elif kind == "forged":
            if self.runner is not None:
                self._step_forged(self.runner, *data)
        elif kind == "control":
            self._hear(decode_control(data))
        elif kind == "opened":
            opened, version = data
            opened(version)
        elif kind == "mended":
            if self.member is not None:
                self.member.mended(data)
        elif kind == "word":
            self._hear(data)
        else:
            self._tick()

    def _hear(self, word: Control) -> None:
        self._around.journal.count(*control_kind(word))
        if self.is_world:
            self._around.journal.trace(f"owner hears {_short(word)}")
        taking = self.member if self.world is None else self.world
        if taking is not None:
            taking.take_word(word)

    def _tick(self) -> None:
        self._ticks += 1
        if self.world is not None:
            self.world.tick()
        elif self.member is not None and (not self.member.active or self._ticks % CHECK_TICKS == 0):
            self.member.join(self.request)
            self.member.fetch_again()

    def _step(self, runner: NodeRunner, message: Message) -> None:
        header, journal = message.header, self._around.journal
        verdict = runner.engine.judge(header)
        journal.count(MESSAGE, header.kind)
        journal.count(VERDICT, verdict.name)
        runner.step(message)
        if not self.forges or ACTIONS[verdict] is not Action.TAKE:
            return
        kind, self.forges = self.forges, ""
        others = forged(kind, message)
        for other in [self._rng.choice(others)] if kind == FORETELL else others:
            self._around.clock.schedule(self._rng.uniform(0.0, FORGED_S), self.take, "forged", (kind, other))

    def _step_forged(self, runner: NodeRunner, kind: str, message: Message) -> None:
        """A message comes that somebody else has made of one that was taken in; a contradiction has to be noticed."""
        header, engine = message.header, runner.engine
        self._around.journal.count(FAULT, kind)
        self._around.journal.trace(f"{self.token}: forged: {header}")
        if isinstance(engine, RatedEngine):
            known = _has_used(engine, header)
        else:
            known = header.when in ((engine.epoch, engine.attempt), self._finished)
            self._around.checker.foretold |= kind == FORETELL  # with rates an epoch has one attempt
        self._around.checker.excused |= kind == CONTRADICT
        self._step(runner, message)
        if kind == CONTRADICT and known:
            self._around.checker.violate(f"{self.token}: nobody notices that another message said something else")

    # --- its node

    def wire(self, roster: Roster) -> Wiring:
        hierarchy = self._around.checker.hierarchy_of(roster)
        place = Place.of(roster)
        bound = hierarchy.bound[self.name]
        tasking = tuple(upper for upper in bound.above if (self.name, upper) in place.tasking)
        node = Inspected(bound, self.inspector, roster.version, tasking, self._act)
        near = {pair: edge for pair, edge in hierarchy.bound_edges.items() if self.name in pair}
        return Wiring(node, inspected_edges(near, self.name, self.inspector), place)

    def _starts(self, turn: Turn) -> None:
        self._around.checker.starts(self.name, self.token, self.engine.state, turn)

    def _calls(self, call: Call, epoch: int) -> None:
        if self.is_world and call.operator == "sense":  # it has no other operator at an epoch's beginning
            self._starts(self.inspector.turn)
        member = self.member
        if member is None:
            return
        told = call.subject.split("->")
        tried = member.tried_now.intersection(told) if self._around.scenario.trials_fail else ()
        if tried:
            self._around.journal.count(FAULT, TRIAL)
            if self._rng.random() < REPLACED_DIES:
                self._around.clock.schedule(0.0, self._kill_replaced, tried, self.engine.wiring.roster)
            raise OperatorError(call.subject, call.operator, epoch, "it fails in its first epoch")
        ends = [name for name in told if name in member.alone | member.tried_now] if self.raises else []
        if ends:
            self.raises = False
            self._around.journal.count(FAULT, RAISE)
            self._around.checker.raised(ends)
            raise OperatorError(call.subject, call.operator, epoch, "it raises, as the scenario says")

    def _kill_replaced(self, tried: Collection[str], version: int) -> None:
        """What was replaced dies, while it waits until what replaces it has done an epoch."""
        checker = self._around.checker
        for process in list(self._around.processes.values()):
            in_force = checker.process_of(version, process.name) == process.token
            comes_back = process.name not in self._around.scenario.left_dead
            if process.name in tried and comes_back and not in_force and checker.had_place(process.token):
                process.at = "killed: it was replaced"
                self._attendant.died(process)

    def _act(self, epoch: int, actions: Any) -> None:
        self.inspector.acts()
        self.point("act")
        self._around.checker.acted(epoch)
        self.point("acted")

    def _tears(self) -> bool:
        self.point("write")
        torn, self.torn = self.torn, False
        if torn:
            self._around.journal.count(FAULT, TORN)
        return torn


def _has_used(engine: RatedEngine, header: Header) -> bool:
    """Whether a message of this header was an input of the node's last epoch, and is at hand as it came."""
    rates, edge = engine.wiring.place.rates, (header.sender, engine.name)
    if header.roster != engine.wiring.roster or rates is None or edge in rates.gathers:
        return False
    return (header.sender, header.kind, *header.when) in engine.used


def _short(word: Any) -> str:
    if isinstance(word, Prepare):
        roster = word.roster
        return f"Prepare(version {roster['version']}, {sorted(roster['nodes'])}, {roster['instances']})"
    return f"{word!r:.160}"
