"""The work of a node in a process of its own, or in one that nodes share: load, connect, run, report."""

import gc
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping
from math import inf
from typing import Any, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hierax.runtime.core.binding import OperatorSetting, Waiter
from hierax.runtime.core.errors import ContradictionError, HieraxError
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.pacemaker import GAP_S, Pacemaker, SteadyClock, call_in
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.host.scheduling import ask_scheduler
from hierax.runtime.launch import frames
from hierax.runtime.launch.inspection_server import InspectionServer
from hierax.runtime.launch.kept_elsewhere import KeptElsewhere, ToldRecords
from hierax.runtime.launch.member_building import (
    open_budget,
    open_observers,
    open_overruns,
    open_slots,
    pacemaker_of,
    preload,
)
from hierax.runtime.launch.node_loop import ControlQueue, NodeLoop, WorldWatch
from hierax.runtime.launch.process_home import ProcessHome
from hierax.runtime.loading.loader import LoadError, extend_import_path
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recording.witness import Witness
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.bus_tap import EpochPublisher, StepPublisher
from hierax.runtime.transport.control import ControlLine, InspectionEndpoint
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.shared_arrays import SharedArrays
from hierax.runtime.transport.zenoh_port import ZenohPort
from hierax.runtime.transport.zenoh_session import LOW_LATENCY_BYTES, allows_shared_memory
from hierax.runtime.watch import telemetry
from hierax.runtime.watch.budget import Budget
from hierax.runtime.watch.logs import NODE, QUIET
from hierax.runtime.watch.overruns import Overruns
from hierax.schemas.control import AskStatus, Control, Dismiss, Offered, Order, Word
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.roster import Roster
from hierax.schemas.values import Value

RECORDER_TIMEOUT_S = 10.0
"""How long a process waits for a recorder that is said to be there; then it goes on unheard, which is a gap."""

OPENS_S = 20.0
"""How long the session and what it declares may take to open, the connection's own patience of 10 s among it.

Zenoh up to 1.10.2 may hang there while other processes come and go (eclipse-zenoh/zenoh#2581): whoever does ends
itself, and another process is started in its place, as after any kill."""

_log = logging.getLogger("hierax")


class NodeWorker:
    """Takes one node from its order to its report. `status`: file descriptor on which the supervisor listens."""

    def __init__(self, order: frames.NodeOrder, status: int, wait: Waiter, home: ProcessHome) -> None:
        self.order = order  # from the supervisor
        self._keys = Keys(order.deployment, order.run)
        self._home = home  # the process, which may have other nodes
        self._wait = wait  # drives async operators
        self._stopping = threading.Event()
        self.pipe = frames.SupervisorPipe(status, self._stopping.set, order.process, home.saying)  # to the supervisor
        self._kept = None if order.slots is None else KeptElsewhere(order.slots, self.pipe)
        self._port: ZenohPort | None = None
        self._declared: list[ControlLine | StepPublisher | InspectionEndpoint] = []
        self._moved: list[ControlLine | InspectionEndpoint | EpochPublisher] = []  # with the port, to another session
        self._shared: SharedArrays | None = None
        self._member: Member | None = None
        self._world: WorldMember | None = None
        self._inspection: InspectionServer | None = None
        self._publisher: StepPublisher
        self._witness: Witness | None = None
        self._budget: Budget | None = None
        self._overruns: Overruns | None = None
        self._recorded = False
        self._thread = 0
        self._opens_s = inf  # since when the session opens; infinite: it does not
        self._words = ControlQueue(self._wake)
        self._loop: NodeLoop | None = None
        self._processes: Mapping[str, str] | None = None
        self._leaves = False
        self._over: Roster | None = None  # the last one, where the run may have been over before it was taken in
        self._epoch: int | None = None
        self._last: int | None = None
        # then the session is not closed: what still comes from its peers would be reported as errors
        self.hurried = False

    # --- called by other threads

    def when(self) -> tuple[int, int]:
        """The epoch and attempt under way, or done last; zeros before the first."""
        engine = None if self._member is None else self._member.engine
        return (0, 0) if engine is None else (engine.epoch, engine.attempt)

    @property
    def active(self) -> bool:
        """Whether the node has taken part in an epoch."""
        return self._member is not None and self._member.active

    def stop(self, last: int | None = None, roster: Value = None) -> None:
        """Make the node's thread come to its end, after the run's last epoch, where that is known. With the last
        roster it reports even where nobody has taken it in."""
        if roster is not None:
            self._over = Roster.read(roster)
        self._last = last
        self._stopping.set()
        self._wake()

    def finish(self) -> None:
        """Make the run come to its end, if this is the world's process."""
        if self._world is not None:
            self._world.pacemaker.asked = True
            self._wake()

    def leave(self, epoch: int | None) -> None:
        """Make the node's thread come to its end at once, and report of an epoch; None: of the last one committed."""
        self._leaves, self._epoch = True, epoch
        self.stop()

    def kept(self, number: int) -> None:
        """All records up to this number are where they outlive the process."""
        if self._kept is not None:
            self._kept.kept(number)

    @property
    def log(self) -> logging.Handler | None:
        """What takes the process's log, where the supervisor is on another host; None: a file here."""
        return None if self._kept is None else ToldRecords(self.pipe)

    def move(self, session: Any, timeout_s: float) -> bool:
        """Have the node go on in another session, between two messages; whether it has before a time is over."""
        loop, port, moved = self._loop, self._port, threading.Event()
        if loop is None or port is None:
            return False
        self._publisher.move(session)  # which waits for who listens, and so not in the node's thread

        def move() -> None:
            with self._home.declaring:
                for each in (port, *self._moved):
                    each.move(session)
            moved.set()

        loop.send_on(move)
        return moved.wait(timeout_s)

    def begin(self, processes: Mapping[str, str]) -> None:
        """Have the world begin the run: all processes are up, these by node."""
        self._processes = processes
        self._wake()

    def post(self, control: Control) -> None:
        """What the supervisor says to the member, or to the owner; never lost."""
        self._words.post(control)

    def hear(self, control: Control, size: int) -> None:
        """What came over Zenoh for the member, or for the owner, and its bytes; lost where too much waits."""
        member = self._member
        if self._port is not None:
            self._port.answered()
        if isinstance(control, AskStatus) and member is not None:  # answered also while the thread is in an operator
            self._say(member.status(control.inquiry, self.busy()))
        elif not self._words.put(control, size):
            _log.warning("%s: dropped %s: too much waits", self.order.name, type(control).__name__)

    def tick(self) -> None:
        if time.monotonic() - self._opens_s > OPENS_S:
            _log.error("%s: Zenoh has hung for %g s; the process ends itself", self.order.name, OPENS_S)
            os.kill(os.getpid(), signal.SIGKILL)
        member = self._member
        if self._inspection is not None:
            self._inspection.serve()
        if member is None:
            return
        if self._publisher.heard != self._recorded:
            self._be_recorded(member.observers, self._publisher.heard)
        if self._loop is not None:
            self._loop.tick()

    def take_turn(self) -> None:
        if self._loop is not None:
            self._loop.take_turn()

    @property
    def period_s(self) -> float | None:
        """In free running, from one turn to the next; None: as it can."""
        order = self.order
        return None if order.rate_hz is None or order.staleness is not None else 1 / order.rate_hz

    def greet(self) -> None:
        """Greet the neighbours that have not answered."""
        port = self._port
        if port is not None and not self._stopping.is_set():
            port.relieve()
            port.greet()
            for process in port.absent.due():
                self.pipe.say(frames.MISSES, process=process)

    def close(self) -> None:
        """Close the port, when no other thread uses it any more; where nodes share the session, all that is theirs."""
        if self._home.beside is not None:
            for declared in self._declared:
                with self._home.declaring:
                    declared.close()
        if self._port is not None:
            self._port.close()

    def part(self, code: int) -> None:
        """Leave a process in which others go on, with an exit code of its own."""
        self.close()
        self._inspection = self._member = self._loop = None
        self.pipe.say(frames.ENDED, code=code)

    # --- the node's thread

    def run(self) -> int:
        """Do all of it, and return the exit code of the process."""
        self._thread = threading.get_ident()
        NODE.set(self.order.name)
        try:
            return self._load_and_run()
        except (HieraxError, SchemaError) as error:
            place = error.where if isinstance(error, LoadError) else ""
            message = str(error)
            if isinstance(error, (TransportError, SchemaError)):  # the others name the node themselves
                message = f"{self.order.name}: {message.removeprefix(f'{self.order.name}: ')}"
            _log.error("%s", message, exc_info=True, extra=QUIET)
            self.pipe.say(
                frames.FAILED,
                message=message.encode(errors="backslashreplace").decode(),
                where=place,
                final=isinstance(error, ContradictionError),
            )
            return 1

    def _load_and_run(self) -> int:
        order = self.order
        setting = OperatorSetting(order.seed, self._wait, self._empty)
        loader = NodeLoader(order.name, setting, order.allowance)
        with self._home.loading:
            extend_import_path(order.import_paths)
            preload(order.preload, order.allowance)
            if order.roster is not None:
                loader.wiring(order.roster)  # what cannot be loaded is told before anybody is waited for
        self._opens_s = time.monotonic()
        session = self._home.session(order)
        most_bytes = LOW_LATENCY_BYTES if order.low_latency else None
        keys = self._keys
        if most_bytes is None and allows_shared_memory(order.settings):
            self._shared = SharedArrays()
        with self._home.declaring:
            port = self._port = ZenohPort(
                session, keys, order.name, order.process, most_bytes, self._shared, self._home.beside
            )
            endpoint = self._declare(session, keys, most_bytes)
        port.heard = lambda: self._publisher.heard
        self._opens_s = inf
        observers, slots = open_observers(order, self.pipe), open_slots(order, self._kept)
        if order.recorded and self._publisher.wait(RECORDER_TIMEOUT_S):
            self._be_recorded(observers, True)
        self._budget = open_budget(order, lambda: observers.engine)
        self._overruns = open_overruns(order, lambda: observers.engine)
        for counts in filter(None, (self._budget, self._overruns)):
            observers.watch(counts)
        if telemetry.wanted():
            observers.watch(telemetry.open_spans(order.deployment, order.run, order.name))
        seen = (order.name, order.process, observers, self._roster)
        self._inspection = InspectionServer(*seen, endpoint, self.busy, self._timing)
        gc.collect()
        gc.freeze()  # what is loaded stays; the collector need not look at it again in the middle of an epoch
        staleness, alone = Staleness(order.staleness), frozenset(order.alone)
        seat = Seat(order.name, order.process, loader.wiring, port, observers, staleness, alone)
        try:
            if order.owner is not None:
                with self._home.declaring:
                    publish = EpochPublisher(session, keys)
                self._moved.append(publish)
                pacemaker = pacemaker_of(order, publish, self.pipe)
                member = self._begin_world(order.owner, seat, port, slots, pacemaker)
            else:
                member = self._begin(seat, port, slots)
            if self._member is not None:
                self._run(self._member, port)
            if member is not None and member.runner is None and self._over is not None and not self.hurried:
                member.recall(seat.wire(self._over))
            if self._leaves:  # nobody waits for what probes do at their end
                return self._part(member)
        finally:
            observers.close()
        return self._part(member)

    def _declare(self, session: Any, keys: Keys, most_bytes: int | None) -> InspectionEndpoint:
        """What others than neighbours say to the node and hear of it."""
        order = self.order
        is_world = order.owner is not None
        offered = () if is_world else (*get_args(Offered), *((Dismiss,) if order.elsewhere else ()))
        self._line = ControlLine(session, keys.control(order.process), offered, self.hear, most_bytes)
        if is_world:
            self._moved.append(ControlLine(session, keys.words("*"), get_args(Word), self.hear, most_bytes))
        self._publisher = StepPublisher(session, keys, order.name)
        endpoint = InspectionEndpoint(session, keys, order.name)
        self._declared += (self._line, self._publisher, endpoint)
        self._moved += (self._line, endpoint)
        return endpoint

    def _empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = float) -> NDArray[Any]:
        return np.empty(shape, dtype) if self._shared is None else self._shared.lender.empty(shape, dtype)

    def _be_recorded(self, observers: Observers, wanted: bool) -> None:
        """Tell steps from now on, or no more."""
        self._recorded = wanted
        if not wanted and self._witness is not None:
            observers.unwatch(self._witness)
        elif wanted:
            is_world = self.order.owner is not None
            told, roster = self._publisher, self._roster if is_world else None
            if self._witness is None:  # else the same one again: what nobody was told of in between is a gap
                self._witness = Witness(self.order.name, lambda: observers.engine, told.step, told.roster, roster)
            self._witness.resume()
            observers.watch(self._witness)
            self._witness.look()

    def _timing(self) -> dict[str, Value]:
        """What the node and the world are held to, and how often they do not keep it."""
        pace = None if self._world is None else self._world.pacemaker.pace
        overruns = {} if self._overruns is None else self._overruns.told()
        return {
            **({"overruns": overruns} if overruns else {}),
            **({} if self._budget is None else {"budget": self._budget.told()}),
            **({} if pace is None else {"pace": pace.told()}),
        }

    def _roster(self) -> Roster | None:
        return None if self._world is None else self._world.owner.members.roster

    def _begin(self, seat: Seat, port: ZenohPort, slots: Slots) -> Member:
        """Come into the run; the member has a part in it where `_member` is set."""
        order = self.order
        member = Member(seat, self._say, Checkpoints(slots))
        if order.life == frames.TO_REPORT and order.roster is not None:
            member.recall(seat.wire(order.roster))
            return member
        if order.life == frames.BEGIN and order.roster is not None:
            wiring = seat.wire(order.roster)
            member.run(wiring)
            if not self._connect(port, wiring):
                return member
        else:
            member.join(order.request)
            port.absent.waits(order.process)
        self.pipe.say(frames.UP)
        self._member = member
        return member

    def _begin_world(
        self, policy: OwnerPolicy, seat: Seat, port: ZenohPort, slots: Slots, pacemaker: Pacemaker
    ) -> Member | None:
        """Begin the run, or go on with it; None: it was stopped before."""
        order, processes, roster = self.order, self.order.processes, None
        if order.life == frames.BEGIN and order.roster is not None:
            roster = order.roster
            if not self._connect(port, seat.wire(roster)):
                return None
            self.pipe.say(frames.UP)
            told = self._until_told(port)
            if told is None:
                return None
            processes = {**told, order.name: order.process}
        clock = SteadyClock(counted_s=GAP_S)  # the thread that asks it is also the one that is in the world's operators
        parts = (seat, self._send_order, self.pipe, slots, pacemaker, policy, clock, processes, roster)
        pauses = order.staleness is not None  # in free running it has turns
        world = self._world = WorldMember(*parts, on_uncertain_act=order.on_uncertain_act, pauses=pauses)
        last = pacemaker.chain
        if last.epoch:  # the process before may not have said so
            pacemaker.on_commit(last.epoch, last.digest)
        world.start()
        if order.life != frames.BEGIN:
            self.pipe.say(frames.UP)
        self._member = world.member
        return world.member

    def _send_order(self, process: str, word: Order) -> None:
        if isinstance(word, Dismiss):  # anybody could say it: who is started here hears it from the supervisor
            self.pipe.dismiss(process, word)
        else:
            self._line.send(self._keys.control(process), word)

    def _say(self, word: Control) -> None:
        """Tell the owner something."""
        self._line.send(self._keys.words(self.order.name), word)

    def _connect(self, port: ZenohPort, wiring: Wiring) -> bool:
        """Open the links to the neighbours; whether that was before the run was stopped."""
        port.link(wiring.node.below, wiring.node.above, wiring.roster, wiring.place.instances, lambda _: None)
        while not port.connect():
            if self._stopping.is_set():
                return False
        return True

    def _until_told(self, port: ZenohPort) -> Mapping[str, str] | None:
        """Wait until the supervisor says that all are up, and which process runs which node; None: it says stop.

        Meanwhile greetings are answered: a process that was killed before the run has begun is started anew.
        """
        while not self._stopping.is_set():
            if self._processes is not None:
                return self._processes
            try:
                port.receive()
            except SchemaError as error:
                _log.warning("%s: dropped what is no message of ours: %s", self.order.name, error)
        return None

    def _run(self, member: Member, port: ZenohPort) -> None:
        order, world = self.order, self._world
        if order.scheduling is not None:
            ask_scheduler(order.name, **order.scheduling)
        watch = None if world is None else WorldWatch(order, self.pipe, world, self.busy)
        self._loop = loop = NodeLoop(order, member, watch, port, self._words, self._stopping)
        loop.run()
        if not (self.hurried or member.dismissed):
            loop.compare_rest()

    def _part(self, member: Member | None) -> int:
        if member is not None and member.dismissed:
            _log.info("%s", member.dismissed)
            self.pipe.say(frames.CUT_OFF if member.again else frames.DISMISSED, why=member.dismissed)
            return int(member.again)
        if self.hurried:
            return 1  # the run is not over: the node is lost, and has nothing to report
        if member is None or member.runner is None:
            return 0
        pacemaker = None if self._world is None else self._world.pacemaker
        if self._leaves and pacemaker is not None:
            self._epoch = pacemaker.chain.epoch
        engine = member.runner.engine
        fields: dict[str, Value] = {**vars(member.runner.report(self._epoch)), "epoch": self._reached(engine)}
        fields["attempt"] = engine.attempt
        if pacemaker is not None:
            chain, times = pacemaker.chain, pacemaker.times
            fields["run"] = [chain.epoch, chain.digest, times.wall_s, times.took_s.numbers()]
        self.pipe.say(frames.REPORT, **fields, timing=self._timing())
        return 0

    def _reached(self, engine: Engine) -> int:
        """The last epoch that the node is done with; with rates it may have no part in it."""
        if self._last is not None and isinstance(engine, RatedEngine) and engine.is_done_with(self._last):
            return self._last
        return engine.epoch

    def _wake(self) -> None:
        if self._port is not None:
            self._port.interrupt()

    def busy(self) -> str:
        """The operator that the node's thread is in; empty: in none."""
        call = call_in(sys._current_frames().get(self._thread))
        return "" if call is None else f"{call.operator} of {call.subject}"
