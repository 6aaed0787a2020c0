"""One node running: its engine joined to a port, and to those who see what it does.

The same in every mode: `run` steps the runners of all nodes in one thread, `launch` has one in each
process. What differs is what a runner has: its `Host`, and at the world's node a `World`.

    a message     port -> `step` -> engine -> `send`, `Host.save`, `World.act` -> what is due is served
    an epoch      `World.begin_next` -> engine; when it is committed, `World.go_on` begins the next one first
    an error      of an operator -> `Host.failed`, which raises it or sees to it that the epoch is done again
"""

import logging

from hierax.runtime.core.binding import metrics_of
from hierax.runtime.core.digest import elements_cannot_travel
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.staleness import BARRIER, Staleness
from hierax.runtime.engine.effects import Called, Committed, Completed, EngineEffects, Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.stale import StaleEngine
from hierax.runtime.engine.table import Verdict
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.report import NodeReport
from hierax.runtime.transport.port import Port
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Header, Message

_log = logging.getLogger("hierax")


class Host:
    """Whose a runner is, and what that does for it; this one keeps nothing, and an error ends the run."""

    def save(self, engine: Engine, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        """Keep a checkpoint, as `EngineEffects.save` has it."""

    def completed(self, completed: Completed) -> None:
        """The node is done with an epoch."""

    def lacks(self, version: int) -> None:
        """A message of a version of the roster came that the node does not have."""

    def rewired(self, version: int) -> None:
        """The node has taken up a version of the roster."""

    def failed(self, error: OperatorError) -> None:
        """An operator or edge function that ran here failed: raise the error, or see that its node is left out."""
        raise error

    def log_level(self, header: Header, verdict: Verdict) -> int:
        """At which level a refusal is logged."""
        return logging.WARNING


class World:
    """What the world's runner has beside: it begins epochs, and acts; this one as long as the pacemaker says so."""

    def __init__(self, pacemaker: Pacemaker) -> None:
        self.pacemaker = pacemaker  # of the run

    def may_begin(self, runner: "NodeRunner") -> bool:
        """Whether an epoch is to be begun, though none was committed."""
        return not runner.staleness.free and self.pacemaker.may_begin(runner.engine)

    def go_on(self, runner: "NodeRunner", committed: Committed | None) -> None:
        """Begin the next epoch, where there is one; before anything else is done."""
        if self.may_begin(runner):
            self.begin_next(runner)

    def begin_next(self, runner: "NodeRunner") -> None:
        """Begin the next epoch, as there is one; in free running at the world's turn."""
        runner.drain(self.pacemaker.limit == runner.engine.epoch + 1)
        self.pacemaker.start()
        runner.engine.begin()

    def act(self, runner: "NodeRunner", epoch: int, actions: Elements) -> None:
        """Move the actuators, by `NodeRunner.move`."""
        runner.move(epoch, actions)

    def committed(self, committed: Committed) -> None:
        """An epoch is committed; `go_on` follows when the engine is done with it."""
        self.pacemaker.stop()

    def settle(self) -> bool:
        """Do what else has come of a step; whether that was anything."""
        return False


class NodeRunner(EngineEffects):
    """Moves messages between a node's engine and its port.

    Raises `OperatorError` if an operator failed, or gave what cannot travel, and `ProbeError` if a probe raised."""

    def __init__(
        self,
        wiring: Wiring,  # of the node
        port: Port,  # of the node, open
        observers: Observers | None = None,  # of the node
        host: Host | None = None,  # whose it is; None: nobody's, so it keeps nothing
        world: World | None = None,  # at the world's node; None at others
        *,
        staleness: Staleness = BARRIER,  # of the deployment
        saved: Saved | None = None,  # as `Engine` has it
        joins: bool = False,  # likewise
    ) -> None:
        self.port = port
        self.observers = Observers(wiring.node.name) if observers is None else observers
        self.world = world
        self.staleness = staleness
        self._host = Host() if host is None else host
        self._completed: list[Completed] = []
        self._committed: Committed | None = None
        self.engine: Engine
        if wiring.place.rates is not None:
            self.engine = RatedEngine(wiring, self, saved=saved, joins=joins)
        elif staleness.barrier:
            self.engine = Engine(wiring, self, saved=saved, joins=joins)
        else:
            self.engine = StaleEngine(wiring, self, saved=saved, joins=joins, staleness=staleness)
        self.observers.follow(self.engine)

    def watch(self, watcher: Watcher) -> None:
        self.observers.watch(watcher)

    def step(self, message: Message) -> None:
        """Take a message in and do all that follows from it."""
        for watcher in self.observers.watchers:
            watcher.received(message)
        try:
            self.engine.receive(message)
        except OperatorError as error:
            self._host.failed(error)
        self.finish()

    def turned(self) -> None:
        """It has waited for its time, which has come."""
        for watcher in self.observers.watchers:
            watcher.turned()

    def poll(self) -> bool:
        """In free running: take part in the next epoch, if there is one; whether there was."""
        engine, world = self.engine, self.world
        before = engine.epoch
        self.turned()
        did = False
        try:
            if world is None:
                did = isinstance(engine, StaleEngine) and engine.poll()
            elif world.pacemaker.may_begin(engine):
                world.begin_next(self)
                did = engine.epoch != before
        except OperatorError as error:
            self._host.failed(error)
            did = True
        self.finish()
        return did

    def finish(self) -> None:
        """Do what follows from a step, also from none at the beginning; the world begins the next epoch first."""
        self._serve()
        while self.world is not None and self.world.settle():
            self._serve()

    def _serve(self) -> None:
        world = self.world
        while self._completed or (world is not None and world.may_begin(self)):
            committed, self._committed = self._committed, None
            completed, self._completed = self._completed, []
            if world is not None:
                self._go_on(world, committed)
            self.observers.completed(completed)
        for watcher in self.observers.watchers:
            watcher.served()

    def _go_on(self, world: World, committed: Committed | None) -> None:
        pacemaker = world.pacemaker
        if committed is not None:
            pacemaker.chain.commit(committed.epoch, committed.digest)
        digest = pacemaker.chain.digest
        world.go_on(self, committed)
        if committed is not None:
            pacemaker.on_commit(committed.epoch, digest)
            for watcher in self.observers.watchers:
                watcher.committed(committed.epoch, digest)

    def drain(self, drains: bool) -> None:
        """Whether the world's next epoch is a drained one; the last one is, so that every node has a part in it."""
        if isinstance(self.engine, (StaleEngine, RatedEngine)):
            self.engine.drains = drains

    def move(self, epoch: int, actions: Elements) -> None:
        """Have the world's actuators move, where it has any."""
        act = self.engine.node.act
        if act is not None:
            act(epoch, self.engine.time_s, actions)
        for watcher in self.observers.watchers:
            watcher.acted(epoch)

    def report(self, committed: int | None = None) -> NodeReport:
        """The node's state, and its figures, after the last epoch committed; None: after the last that it has done."""
        engine = self.engine
        ahead = committed is not None and self.staleness.barrier and engine.epoch > committed
        state = engine.start if ahead else engine.state
        metrics = metrics_of(engine.name, engine.node.node, state.belief, engine.epoch - ahead)
        if isinstance(engine, StaleEngine):
            metrics.update(engine.ages.metrics())
        return NodeReport(*state, metrics)

    # --- what the engine calls

    def send(self, message: Message) -> None:
        for watcher in self.observers.watchers:
            message = watcher.sending(message)
        try:
            self.port.send(message)
        except SchemaError as error:
            kind, sender, receiver, epoch = message.header[:4]
            raise elements_cannot_travel(kind, sender, receiver, epoch, error) from error
        for watcher in self.observers.watchers:
            watcher.sent(message)

    def called(self, called: Called) -> None:
        for watcher in self.observers.watchers:
            watcher.called(called)

    def rewired(self, version: int) -> None:
        for watcher in self.observers.watchers:
            watcher.rewired(version)
        self._host.rewired(version)

    def lacks(self, version: int) -> None:
        self._host.lacks(version)

    def save(self, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        self._host.save(self.engine, epoch, attempt, start, now)

    def predicted(self, completed: Completed) -> None:
        self.observers.predicted(completed)

    def completed(self, completed: Completed) -> None:
        self._completed.append(completed)
        self._host.completed(completed)

    def act(self, epoch: int, actions: Elements) -> None:
        if self.world is not None:
            self.world.act(self, epoch, actions)

    def committed(self, committed: Committed) -> None:
        self._committed = committed
        if self.world is not None:
            self.world.committed(committed)

    def refused(self, header: Header, verdict: Verdict) -> None:
        what = (self.engine.name, header.kind, header.sender, header.epoch, verdict.value)
        _log.log(self._host.log_level(header, verdict), "%s: refused a %s message from %s of epoch %d: %s", *what)
        for watcher in self.observers.watchers:
            watcher.refused(header, verdict)
