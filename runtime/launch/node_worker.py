"""The work of a node in a process of its own: load, connect, run, report."""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from types import FrameType
from typing import get_args

import numpy as np

from hierax.runtime.core.binding import CALLS, Call, OperatorSetting, Waiter
from hierax.runtime.core.errors import ContradictionError, HieraxError
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch.control_queue import ControlQueue
from hierax.runtime.launch.frames import (
    BEGIN,
    CUT_OFF,
    DISMISSED,
    FAILED,
    MISSES,
    REPORT,
    TO_REPORT,
    UP,
    NodeOrder,
)
from hierax.runtime.launch.inspection_server import InspectionServer
from hierax.runtime.launch.member_building import (
    build_member,
    build_world,
    open_observers,
    open_slots,
    pacemaker_of,
    preload,
)
from hierax.runtime.launch.steady import SteadyClock
from hierax.runtime.launch.supervisor_pipe import SupervisorPipe
from hierax.runtime.loading.loader import LoadError, extend_import_path
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recording.witness import Witness
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.control import OWNER, ControlLine
from hierax.runtime.transport.inspection import InspectionEndpoint
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.steps import StepPublisher
from hierax.runtime.transport.zenoh_port import EpochPublisher, ZenohPort
from hierax.runtime.transport.zenoh_session import LOOPBACK, LOW_LATENCY_BYTES, open_session
from hierax.runtime.watch import telemetry
from hierax.runtime.watch.logs import QUIET
from hierax.schemas.control import AskStatus, Control, Dismiss, Offered, Word, decode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.messages import Message
from hierax.schemas.roster import Roster
from hierax.schemas.values import Value

IDLE_S = 0.5  # how long a node may get no further before it asks whether it is still part of the hierarchy
WORDS_AT_ONCE = 64  # how many control messages are taken in between two messages of an epoch
REST = 10_000  # how many messages are looked at when the run is over

RECORDER_TIMEOUT_S = 10.0
"""How long a process waits for a recorder that is said to be there; then it goes on unheard, which is a gap."""

BEAT_S = 0.2  # how often the world's process says that it lives

_log = logging.getLogger("hierax")


class NodeWorker:
    """One node, from its order to its report.

    Args:
        order: from the supervisor.
        status: file descriptor on which the supervisor listens.
        wait: drives async operators.
    """

    def __init__(self, order: NodeOrder, status: int, wait: Waiter) -> None:
        self._order = order
        self._wait = wait
        self._stopping = threading.Event()
        self._pipe = SupervisorPipe(status, self._stopping.set)
        self._port: ZenohPort | None = None
        self._member: Member | None = None
        self._world: WorldMember | None = None
        self._inspection: InspectionServer | None = None
        self._publisher: StepPublisher
        self._witness: Witness | None = None
        self._recorded = False
        self._thread = 0
        self._inputs: deque[Control] = deque()
        self._words = ControlQueue()
        self._woken = False
        self._processes: Mapping[str, str] | None = None
        self._clock = SteadyClock()
        self._ticks = False
        self._ticked_s = self._moved_s = time.monotonic()
        self._place: tuple[object, ...] = ()
        self._beaten_s = 0.0
        self._version = -1
        self._rate_hz = order.rate_hz
        self._due = True
        self._stuck: tuple[int, str] = (0, "")
        self._stuck_s = 0.0
        self._leaves = False
        self._epoch: int | None = None
        # then the session is not closed: what still comes from its peers would be reported as errors
        self.hurried = False

    # --- called by other threads

    def when(self) -> tuple[int, int]:
        """The epoch and attempt under way, or done last; zeros before the first."""
        engine = None if self._member is None else self._member.engine
        return (0, 0) if engine is None else (engine.epoch, engine.attempt)

    def stop(self) -> None:
        """Make the node's thread come to its end."""
        self._stopping.set()
        self._wake()

    def finish(self) -> None:
        """Make the run come to its end, if this is the world's process."""
        if self._world is not None:
            self._world.pacemaker.asked = True
            self._wake()

    def leave(self, epoch: int | None) -> None:
        """Make the node's thread come to its end, whatever is under way, and report.

        Args:
            epoch: of which the report is; None: the last one committed, which the world knows.
        """
        self._leaves, self._epoch = True, epoch
        self.stop()

    def begin(self, processes: Mapping[str, str]) -> None:
        """Have the world begin the run: all processes are up, these by node."""
        self._processes = processes
        self._wake()

    def post(self, control: Control) -> None:
        """What the supervisor says to the member, or to the owner; never lost."""
        self._inputs.append(control)
        self._wake()

    def hear(self, control: Control, size: int) -> None:
        """What came over Zenoh for the member, or for the owner, and its bytes; lost where too much waits."""
        member = self._member
        if isinstance(control, AskStatus) and member is not None:  # answered also while the thread is in an operator
            self._line.tell(OWNER, member.status(control.inquiry, self.busy()))
        elif not self._words.put(control, size):
            _log.warning("%s: dropped %s: too much waits", self._order.name, type(control).__name__)
        elif not self._woken:
            self._woken = True
            self._wake()

    def tick(self) -> None:
        """Time has passed."""
        member = self._member
        if self._inspection is not None:
            self._inspection.serve()
        if member is None:
            return
        if self._publisher.heard != self._recorded:
            self._be_recorded(member.observers, self._publisher.heard)
        now = time.monotonic()
        if self._world is not None:
            self._watch_world(self._world, now)
        elif member.active and now - max(self._when_moved(member, now), self._ticked_s) < IDLE_S:
            return
        if not self._ticks:
            self._ticked_s = now
            self._ticks = True
            self._wake()

    def _when_moved(self, member: Member, now: float) -> float:
        """When the node has got further in its epochs; what others send it may be of no use."""
        engine = member.engine
        place = () if engine is None else (engine.epoch, engine.attempt, engine.phase)
        if place != self._place:
            self._place, self._moved_s = place, now
        return self._moved_s

    def take_turn(self) -> None:
        """In free running: the node's next turn is due."""
        self._due = True
        self._wake()

    @property
    def period_s(self) -> float | None:
        """In free running, from one turn to the next; None: as it can."""
        return None if self._rate_hz is None else 1 / self._rate_hz

    def greet(self) -> None:
        """Greet the neighbours that have not answered."""
        port = self._port
        if port is not None and not self._stopping.is_set():
            port.greet()
            for process in port.absent.due():
                self._pipe.say(MISSES, process=process)

    def close(self) -> None:
        """Close the port, when no other thread uses it any more."""
        if self._port is not None:
            self._port.close()

    # --- the node's thread

    def run(self) -> int:
        """All of it.

        Returns:
            The exit code of the process.
        """
        self._thread = threading.get_ident()
        try:
            return self._load_and_run()
        except (HieraxError, SchemaError) as error:
            place = error.where if isinstance(error, LoadError) else ""
            message = str(error)
            if isinstance(error, (TransportError, SchemaError)):  # the others name the node themselves
                message = f"{self._order.name}: {message.removeprefix(f'{self._order.name}: ')}"
            _log.error("%s", message, exc_info=True, extra=QUIET)
            self._pipe.say(
                FAILED,
                message=message.encode(errors="backslashreplace").decode(),
                where=place,
                final=isinstance(error, ContradictionError),
            )
            return 1

    def _load_and_run(self) -> int:
        order = self._order
        extend_import_path(order.import_paths)
        preload(order.preload, order.allowance)
        loader = NodeLoader(order.name, OperatorSetting(order.seed, self._wait), order.allowance)
        if order.roster is not None:
            loader.wiring(order.roster)  # what cannot be loaded is told before anybody is waited for
        listen = [f"tcp/{order.host}:0"] if order.host else [LOOPBACK]
        session = open_session(listen, [order.hub], order.settings, low_latency=order.low_latency)
        most_bytes = LOW_LATENCY_BYTES if order.low_latency else None
        keys = Keys(order.deployment, order.run)
        port = self._port = ZenohPort(session, keys, order.name, order.process, most_bytes)
        is_world = order.owner is not None
        offered = () if is_world else (*get_args(Offered), *((Dismiss,) if order.elsewhere else ()))
        self._line = ControlLine(session, keys, order.process, offered, self.hear, most_bytes)
        if is_world:
            self._owners_line = ControlLine(session, keys, OWNER, get_args(Word), self.hear, most_bytes)
        observers, slots = open_observers(order), open_slots(order)
        self._publisher = StepPublisher(session, keys, order.name)
        if order.recorded and self._publisher.wait(RECORDER_TIMEOUT_S):
            self._be_recorded(observers, True)
        if telemetry.wanted():
            observers.watch(telemetry.open_spans(order.deployment, order.run, order.name))
        endpoint = InspectionEndpoint(session, keys, order.name)
        seen = (order.name, order.process, observers, self._roster)
        self._inspection = InspectionServer(*seen, endpoint, self.busy)
        gc.collect()
        gc.freeze()  # what is loaded stays; the collector need not look at it again in the middle of an epoch
        try:
            if order.owner is not None:
                pacemaker = pacemaker_of(order, EpochPublisher(session, keys))
                member = self._begin_world(order.owner, loader, port, observers, slots, pacemaker)
            else:
                member = self._begin(loader, port, observers, slots)
            if self._member is not None:
                loop = self._run_freely if order.staleness is None else self._run
                loop(self._member, port)
            if self._leaves:  # nobody waits for what probes do at their end
                return self._part(member)
        finally:
            observers.close()
        return self._part(member)

    def _be_recorded(self, observers: Observers, wanted: bool) -> None:
        """Tell steps from now on, or no more."""
        self._recorded = wanted
        if not wanted and self._witness is not None:
            observers.unwatch(self._witness)
        elif self._witness is not None:  # the same one again: what nobody was told of in between is a gap
            self._witness.resume()
            observers.watch(self._witness)
        elif wanted:
            is_world = self._order.owner is not None
            self._witness = Witness(
                self._order.name, lambda: observers.engine, self._publisher, self._roster if is_world else None
            )
            observers.watch(self._witness)

    def _roster(self) -> Roster | None:
        """In force, as the world's process knows it."""
        return None if self._world is None else self._world.owner.roster

    def _begin(self, loader: NodeLoader, port: ZenohPort, observers: Observers, slots: Slots) -> Member:
        """Come into the run; the member has a part in it where `_member` is set."""
        order = self._order
        member = build_member(order, loader, port, self._line, observers, slots)
        if order.life == TO_REPORT and order.roster is not None:
            member.recall(loader.wiring(order.roster))
            return member
        if order.life == BEGIN and order.roster is not None:
            wiring = loader.wiring(order.roster)
            member.run(wiring)
            if not self._connect(port, wiring):
                return member
        else:
            member.join(order.request)
        self._pipe.say(UP)
        self._member = member
        return member

    def _begin_world(
        self,
        policy: OwnerPolicy,
        loader: NodeLoader,
        port: ZenohPort,
        observers: Observers,
        slots: Slots,
        pacemaker: Pacemaker,
    ) -> Member | None:
        """Begin the run, or go on with it; None: it was stopped before."""
        order, processes = self._order, self._order.processes
        if order.life == BEGIN and order.roster is not None:
            if not self._connect(port, loader.wiring(order.roster)):
                return None
            self._pipe.say(UP)
            told = self._until_told(port)
            if told is None:
                return None
            processes = {**told, order.name: order.process}
        parts = (loader, port, self._line, observers, slots, self._pipe, pacemaker, processes)
        world = self._world = build_world(order, policy, *parts)
        last = pacemaker.chain
        if last.epoch:  # the process before may not have said so
            pacemaker.on_commit(last.epoch, last.digest)
        world.start()
        if order.life != BEGIN:
            for proposal in order.proposals:
                world.hear(decode_control(proposal))
            self._pipe.say(UP)
        self._member = world.member
        return world.member

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
                _log.warning("%s: dropped what is no message of ours: %s", self._order.name, error)
        return None

    def _run(self, member: Member, port: ZenohPort) -> None:
        paused = False
        while not self._stopping.is_set():
            if self._inputs or self._words or self._ticks:
                self._serve(member)
            if member.dismissed:
                return
            if self._world is not None:
                self._serve_supervisor(self._world)
                if self._world.paused:
                    self._world.resume()
                paused = self._world.paused
            self._take_next(member, port.poll if self._words or paused else port.receive)
        self._compare_rest(member, port)

    def _run_freely(self, member: Member, port: ZenohPort) -> None:
        """As `_run`, but the node takes its turns when they are due, on the newest of what has come."""
        while not self._stopping.is_set():
            self._serve(member)
            if member.dismissed:
                return
            if self._world is not None:
                self._serve_supervisor(self._world)
            self._take_all(member, port)
            if self._due and member.runner is not None:
                self._due = self._rate_hz is None  # the next turn may be due before this one is over
                if member.runner.poll():
                    continue
                self._due = True
            self._take_next(member, port.poll if self._words else port.receive)

    def _take_all(self, member: Member, port: ZenohPort) -> None:
        while self._take_next(member, port.poll):
            continue

    def _take_next(self, member: Member, receive: Callable[[], Message | None]) -> bool:
        try:
            message = receive()
        except SchemaError as error:
            _log.warning("%s: dropped what is no message of ours: %s", self._order.name, error)
            return True
        if message is None:
            return False
        if member.runner is not None:
            member.runner.step(message)
        return True

    def _compare_rest(self, member: Member, port: ZenohPort) -> None:
        """The run is over: what is still there is taken in no more, but may show that something was forged."""
        engine = member.engine
        if self.hurried or engine is None or not member.staleness.barrier:
            return
        for _ in range(REST):
            try:
                message = port.poll()
            except SchemaError:
                continue
            if message is None:
                return
            engine.compare(message)

    def _serve(self, member: Member) -> None:
        """What has come beside the messages of epochs; of what anybody may say, not more than so much at once."""
        take_word = member.take_word if self._world is None else self._world.take_word
        self._woken = False
        while self._inputs:
            take_word(self._inputs.popleft())
        for _ in range(WORDS_AT_ONCE):
            word = self._words.take()
            if word is None:
                break
            take_word(word)
        if not self._ticks:
            return
        self._ticks = False
        if self._world is not None:
            self._world.tick()
        else:
            member.join(self._order.request)
            member.fetch_again()

    def _serve_supervisor(self, world: WorldMember) -> None:
        owner = world.owner
        if owner.roster.version != self._version:
            self._version = owner.roster.version
            self._pipe.beat(owner)
        if world.pacemaker.asked:
            world.end_soon()
        if world.pacemaker.done:
            self._pipe.finish(owner)

    def _part(self, member: Member | None) -> int:
        if member is not None and member.dismissed:
            _log.info("%s", member.dismissed)
            self._pipe.say(CUT_OFF if member.again else DISMISSED, why=member.dismissed)
            return int(member.again)
        if self.hurried:
            return 1  # the run is not over: the node is lost, and has nothing to report
        if member is None or member.runner is None:
            return 0
        pacemaker = None if self._world is None else self._world.pacemaker
        if self._leaves and pacemaker is not None:
            self._epoch = pacemaker.chain.epoch
        report = member.runner.report(self._epoch)
        fields: dict[str, Value] = {
            "belief": report.belief,
            "policy": report.policy,
            "actions": report.actions,
            "metrics": dict(report.metrics),
            "epoch": member.runner.engine.epoch,
            "attempt": member.runner.engine.attempt,
        }
        if pacemaker is not None:
            chain = pacemaker.chain
            fields["run"] = [chain.epoch, chain.digest, pacemaker.wall_s, np.array(pacemaker.epochs_s)]
        self._pipe.say(REPORT, **fields)
        return 0

    # --- helpers of both

    def _watch_world(self, world: WorldMember, now: float) -> None:
        """The world's process says that it lives; and when it hangs in an operator, as nobody else watches that."""
        if now - self._beaten_s >= BEAT_S:
            self._beaten_s = now
            self._pipe.beat(world.owner)
        state, steady_s = (world.owner.epoch, self.busy()), self._clock()
        if not state[1] or state != self._stuck:
            self._stuck, self._stuck_s = state, steady_s
            return
        deadline_s = self._order.owner.epoch_deadline_s if self._order.owner is not None else None
        if deadline_s is not None and steady_s - self._stuck_s > deadline_s:
            self._stuck_s = steady_s
            why = f"it is in {state[1]} in epoch {state[0] + 1}, past the deadline"
            self._pipe.end(self._order.name, self._order.process, why)

    def _wake(self) -> None:
        if self._port is not None:
            self._port.interrupt()

    def busy(self) -> str:
        """The operator that the node's thread is in; empty: in none."""
        found: FrameType | None = sys._current_frames().get(self._thread)
        while found is not None:
            if found.f_code in CALLS:
                call: Call = found.f_locals["self"]
                return f"{call.operator} of {call.subject}"
            found = found.f_back
        return ""
