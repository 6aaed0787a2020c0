"""A node's answers to those who look at it; given by the event loop's thread, never by the node's.

A question is a map with ``"look"``, as is the answer:

    meter       where the node's time goes, and what a world counts; measured from the first such question until nobody
                has asked for `LEASE_S`, so that it costs nothing while nobody looks
    state       what the node believes, has chosen and was given in the last epoch that it has completed
    neighbours  the names of the nodes below and above
    echo        copies of the messages in ``"edges"``, each kind, sender and receiver, for `LEASE_S`
    steps       what the node does in one of ``"every"`` epochs, for `LEASE_S`; of the world's also the roster
    roster      of the world's process, the roster in force; of others nothing
"""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hierax.runtime.core.binding import metrics_of
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.node import class_name
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.stale import StaleEngine
from hierax.runtime.engine.table import Phase
from hierax.runtime.execution.observers import Observers
from hierax.runtime.transport.control import InspectionEndpoint
from hierax.runtime.watch.meter import Meter
from hierax.runtime.watch.watcher import Copier, Edge, Stepper, Watcher
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import STEP, check_name
from hierax.schemas.messages import EDGE_KINDS
from hierax.schemas.roster import Roster
from hierax.schemas.values import Value

LEASE_S = 5.0  # how long a watcher stays after the last question that needs it
MAX_EDGES = 4096  # how many edges are echoed at most

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


@dataclass(eq=False, repr=False)
class InspectionServer:
    """Answers the questions that a node is asked."""

    name: str  # of the node
    process: str  # the process's token
    observers: Observers  # of the node
    roster: Callable[[], Roster | None]  # of the world's process, once the run has begun, gives the roster in force
    endpoint: InspectionEndpoint  # where they come in
    busy: Callable[[], str]  # the operator that the node's thread is in, as ``OPERATOR of SUBJECT``; empty: in none
    timing: Callable[[], Mapping[str, Value]] = dict  # gives what the node is held to, and how often it did not keep it

    def __post_init__(self) -> None:
        self._meter, self._copier, self._stepper = Meter(), Copier(self.endpoint.show), Stepper()
        self._until_s: dict[Watcher, float] = {}  # of those that watch now
        self._wanted: dict[Edge, float] = {}
        self._looks: Mapping[str, Callable[[Mapping[str, Any]], dict[str, Value]]] = {
            "meter": self._answer_times,
            "state": self._answer_state,
            "neighbours": self._answer_neighbours,
            "echo": self._echo,
            "steps": self._answer_steps,
            "roster": self._answer_roster,
        }

    def serve(self) -> None:
        """Answer what was asked, and give up what nobody asks for any more."""
        for question, reply in self.endpoint.questions():
            reply(self._answer(question))
        for data in self._stepper.take():
            self.endpoint.show(STEP, self.name, self.name, data)
        self._expire(time.monotonic())

    def _answer(self, question: Value) -> Value:
        name = question.get("look") if isinstance(question, dict) else None
        look = self._looks.get(name) if isinstance(name, str) else None
        if look is None:
            return {"refusal": f"expected a map with 'look' as one of {', '.join(self._looks)}"}
        try:
            return {"process": self.process, **look(question)}
        except SchemaError as error:
            return {"refusal": str(error)}

    def _answer_times(self, question: Mapping[str, Any]) -> dict[str, Value]:
        if self._meter not in self._until_s:
            self._meter = Meter()
        self._lease(self._meter)
        busy = self.busy()
        engine = self.observers.engine
        waits = () if engine is None else engine.waits_for
        ready = engine is None or engine.phase is Phase.DONE  # for the next epoch, and nobody owes it anything
        return {
            "pid": os.getpid(),
            "epoch": 0 if engine is None else engine.epoch,
            "attempt": 0 if engine is None else engine.attempt,
            "in_force": dict(engine.in_force) if isinstance(engine, RatedEngine) else {},
            "busy": busy,
            "waits_for": [] if ready else [list(slot) for slot in waits],
            "rss_bytes": _rss_bytes(),
            "cpu_s": time.process_time(),
            "metrics": {} if engine is None or not engine.is_world else _figures(engine),
            "meter": self._meter.read(busy.partition(" of ")[0], waits[0][0] if waits else ""),
            "timing": self.timing(),
        }

    def _answer_state(self, question: Mapping[str, Any]) -> dict[str, Value]:
        engine, last = self.observers.engine, self.observers.last
        if engine is None:
            return {"epoch": 0, "refusal": "the node's process is still coming into the run"}
        node = engine.node
        told: dict[str, Value] = {
            "class": class_name(node.node),
            "below": list(node.below),
            "above": list(node.above),
            "policies": sorted(node.policies),
            "roster": engine.wiring.roster,
            "instance": engine.wiring.instance,
        }
        if last is None:  # nothing was done by this process yet
            when = {"epoch": engine.epoch, "attempt": engine.attempt}
            return {**told, **when, "committed": True, **engine.state._asdict()}
        step = last.step
        committed = None if isinstance(engine, StaleEngine) else engine.epoch > step.epoch or engine.is_world
        about = {"committed": committed, "digest": last.digest, "before": self.observers.before}
        return {**told, **step._asdict(), **about}

    def _answer_neighbours(self, question: Mapping[str, Any]) -> dict[str, Value]:
        engine = self.observers.engine
        return {side: [] if engine is None else list(getattr(engine.node, side)) for side in ("below", "above")}

    def _echo(self, question: Mapping[str, Any]) -> dict[str, Value]:
        until_s = time.monotonic() + LEASE_S
        for kind, sender, receiver in _edges_of(question):
            known = (kind, sender, receiver) in self._wanted or len(self._wanted) < MAX_EDGES
            if sender == self.name and known:
                self._wanted[kind, sender, receiver] = until_s
        self._copier.wanted = frozenset(self._wanted)
        if self._wanted:
            self._lease(self._copier)
        return {"lease_s": LEASE_S}

    def _answer_steps(self, question: Mapping[str, Any]) -> dict[str, Value]:
        every = question.get("every")
        if type(every) is not int or every < 1:
            raise SchemaError(f"expected a whole number from 1, got {shown(every)}", "every")
        self._lease(self._stepper)
        self._stepper.every = every
        return {"lease_s": LEASE_S, **self._answer_roster(question)}

    def _answer_roster(self, question: Mapping[str, Any]) -> dict[str, Value]:
        roster = self.roster()
        return {"roster": None if roster is None else roster.plain()}

    def _lease(self, watcher: Watcher) -> None:
        if watcher not in self._until_s:
            self.observers.watch(watcher)
        self._until_s[watcher] = time.monotonic() + LEASE_S

    def _expire(self, now: float) -> None:
        self._wanted = {edge: until_s for edge, until_s in self._wanted.items() if until_s > now}
        self._copier.wanted = frozenset(self._wanted)
        for watcher in [each for each, until_s in self._until_s.items() if now > until_s]:
            self.observers.unwatch(watcher)
            del self._until_s[watcher]


def _figures(world: Engine) -> dict[str, Value]:
    """What the world counts; nothing where it cannot."""
    try:
        return dict(metrics_of(world.name, world.node.node, world.state.belief, world.epoch))
    except OperatorError:
        return {}


def _edges_of(question: Mapping[str, Any]) -> list[Edge]:
    edges = question.get("edges")
    if not isinstance(edges, (tuple, list)) or len(edges) > MAX_EDGES:
        raise SchemaError(f"expected at most {MAX_EDGES} edges", "edges")
    found: list[Edge] = []
    for edge in edges:
        if not isinstance(edge, (tuple, list)) or len(edge) != 3 or not all(isinstance(part, str) for part in edge):
            raise SchemaError(f"expected [kind, sender, receiver], got {shown(edge)}", "edges")
        kind, sender, receiver = edge
        if kind not in EDGE_KINDS:
            raise SchemaError(f"expected one of {', '.join(EDGE_KINDS)}, got {shown(kind)}", "edges")
        found.append((kind, check_name(sender), check_name(receiver)))
    return found


def _rss_bytes() -> int:
    """The memory that this process has in hand; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm", "rb") as statm:
            return int(statm.read().split()[1]) * _PAGE_BYTES
    except (OSError, IndexError, ValueError):
        return 0
