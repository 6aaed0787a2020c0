"""A simulated process: production code, and an end at any of its calls."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.member import Member
from hierax.runtime.sim.inspection import Inspected, Inspector, Turn, inspected_edges
from hierax.runtime.sim.network import Pair
from hierax.runtime.sim.storage import Crash, SimStorage
from hierax.schemas.control import AskStatus, Dismiss, HandOver, Order, Prepare, Resend, TakeOver, decode_control
from hierax.schemas.messages import decode_message
from hierax.schemas.roster import Roster

if TYPE_CHECKING:
    from hierax.runtime.sim.simulation import Simulation

_ORDERS = (Prepare, HandOver, TakeOver, AskStatus, Resend, Dismiss)

TICK_S = 0.05
"""How often a process looks after itself."""

CHECK_TICKS = 4
"""Every how many ticks it asks whether it is still wanted."""


class SimProcess:
    """One process of a node.

    Attributes:
        name, token: of the node, and of the process alone.
        request: the change that the first process of its line was started for.
        storage: of its checkpoints; its line's.
        links: ends of links, by version of the roster.
        opening: what is to be called when a version's links are open.
        calls_left: at which call it dies; 0: it doesn't.
        torn: whether it dies in its next write.
        at: the last call that it made.
    """

    member: Member

    def __init__(self, simulation: Simulation, name: str, token: str, request: str, storage: SimStorage) -> None:
        self.name = name
        self.token = token
        self.request = request
        self.storage = storage
        self.alive = True
        self.links: dict[int, frozenset[Pair]] = {}
        self.opening: dict[int, Callable[[int], None]] = {}
        self.calls_left = 0
        self.torn = False
        self.at = ""
        self.frozen = 0
        self.busy = False
        self.slowness_s = 0.0
        self._simulation = simulation
        self._backlog: deque[tuple[str, Any]] = deque()
        self._ticks = 0
        checker = simulation.checker
        self.inspector = Inspector(name, token, checker.violate, checker.process_of, self._starts)
        storage.tears = self._tears

    @property
    def is_world(self) -> bool:
        """Whether it runs the world."""
        return self.name == self._simulation.scenario.roster.world

    def point(self, what: str) -> None:
        """A call to the outside, or the return of one: the process may die here."""
        self.at = what
        if self.calls_left:
            self.calls_left -= 1
            if not self.calls_left:
                raise Crash

    def run(self, what: Callable[[], None]) -> None:
        """Do something in this process."""
        try:
            what()
        except Crash:
            self._simulation.keepers.died(self)
            return
        if self.alive and self.member.dismissed:
            self._simulation.trace(f"{self.token} is dismissed: {self.member.dismissed}")
            if self.member.again:
                self.at = "dismissed"
                self._simulation.keepers.died(self)
            else:
                self._simulation.keepers.exited(self)

    def take(self, kind: str, data: Any) -> None:
        """Something comes in; handled now, or later where the process cannot."""
        if not self.alive:
            return
        if self.frozen:
            if self.busy and kind == "control":
                word = decode_control(data)
                if isinstance(word, AskStatus):
                    status = self.member.status(word.inquiry, busy="observe")
                    self.run(lambda: self._simulation.say(self, status))
                    return
            self._backlog.append((kind, data))
            return
        self.run(lambda: self._handle(kind, data))
        if self.slowness_s and kind == "message":
            self.freeze()
            self._simulation.clock.schedule(self.slowness_s, self.thaw)

    def freeze(self) -> None:
        """It handles nothing until it is thawed as often."""
        self.frozen += 1

    def thaw(self) -> None:
        """It goes on, if nothing else keeps it."""
        self.frozen -= 1
        if not self.frozen:
            self.busy = False
        while self._backlog and not self.frozen and self.alive:
            self.take(*self._backlog.popleft())

    def _handle(self, kind: str, data: Any) -> None:
        if kind == "message":
            if self.member.wired:
                self.member.step(decode_message(data))
        elif kind == "control":
            self._hear(decode_control(data))
        elif kind == "opened":
            opened, version = data
            opened(version)
        elif kind == "mended":
            self.member.port.mended(data)
        elif kind == "word":
            self._hear(data)
        else:
            self._tick()

    def _hear(self, word: Any) -> None:
        if isinstance(word, _ORDERS):
            order: Order = word
            self.member.obey(order)
        else:
            self._simulation.hear(self, word)

    def _tick(self) -> None:
        self._ticks += 1
        if self.is_world:
            self._simulation.tick_world(self)
            return
        if not self.member.active or self._ticks % CHECK_TICKS == 0:
            self.member.join(self.request)
            self.member.fetch_again()

    def wire(self, roster: Roster) -> Wiring:
        """What loads the node in production."""
        hierarchy = self._simulation.checker.hierarchy_of(roster)
        place = Place.of(roster)
        bound = hierarchy.bound[self.name]
        tasking = tuple(upper for upper in bound.above if (self.name, upper) in place.tasking)
        node = Inspected(bound, self.inspector, roster.version, tasking, self._act)
        near = {pair: edge for pair, edge in hierarchy.bound_edges.items() if self.name in pair}
        return Wiring(node, inspected_edges(near, self.name, self.inspector, self._senses), place)

    def _senses(self) -> None:
        """Before a sense function: the world has no other operator at an epoch's beginning."""
        if self.is_world:
            self._starts(self.inspector.turn)

    def _starts(self, turn: Turn) -> None:
        self._simulation.checker.starts(self.name, self.token, self.member.engine.state, turn)

    def _act(self, epoch: int, actions: Any) -> None:
        self.inspector.acts()
        self.point("act")
        self._simulation.checker.acted(epoch)
        self.point("acted")

    def _tears(self) -> bool:
        self.point("write")
        torn, self.torn = self.torn, False
        if torn:
            self._simulation.checker.counted("torn")
        return torn
