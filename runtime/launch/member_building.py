"""From an order to a member of the run, and what that has from the process's first instant on."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.output_folder import digest_log, open_probes, state_log
from hierax.runtime.execution.pacemaker import Pacemaker, SteadyClock
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch.faults import plant
from hierax.runtime.launch.frames import BEGIN, NodeOrder, SupervisorPipe
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.control import OWNER, ControlLine
from hierax.runtime.transport.zenoh_port import EpochPublisher, ZenohPort
from hierax.schemas.control import Dismiss, Order

_log = logging.getLogger("hierax")


def open_observers(order: NodeOrder) -> Observers:
    """The state log and the probes that an order names, open. Raises `HieraxError` if one cannot be opened."""
    output, again = order.output_path, order.life != BEGIN
    probes = open_probes(order.probes, order.name, order.allowance, output, again)
    return Observers(order.name, probes, state_log(output, order.name, again))


def open_slots(order: NodeOrder) -> Slots:
    """Where the node's checkpoints are, or the world's record. Raises `HieraxError` if the file cannot be opened."""
    return Slots(MappedFile(Path(order.checkpoint), order.durability))


@dataclass
class Parts:
    """What a node's process has for its member. What it builds raises `HieraxError` if the order's fault is none."""

    order: NodeOrder  # of the process
    loader: NodeLoader  # of the node
    port: ZenohPort  # likewise
    line: ControlLine  # to the roster's owner, or from it
    observers: Observers  # of the node
    slots: Slots  # of its checkpoints, or of the world's record

    def member(self) -> Member:
        """The member that the order asks for, if it is not the world's."""
        member = Member(self._seat(), lambda word: self.line.send(OWNER, word), Checkpoints(self.slots))
        if self.order.fault:
            plant(self.order.fault, member, None)
        return member

    def world(
        self, policy: OwnerPolicy, pipe: SupervisorPipe, pacemaker: Pacemaker, processes: Mapping[str, str]
    ) -> WorldMember:
        """The world's member, not started. Raises `HieraxError` if there is no whole record where one has to be."""
        order = self.order

        def send_order(process: str, word: Order) -> None:
            if isinstance(word, Dismiss):  # anybody could say it: who is started here hears it from the supervisor
                pipe.dismiss(process, word)
            else:
                self.line.send(process, word)

        roster = order.roster if order.life == BEGIN else None
        parts = (self._seat(), send_order, pipe, self.slots, pacemaker, policy, SteadyClock(), processes, roster)
        pauses = order.staleness is not None  # in free running it has turns
        world = WorldMember(*parts, on_uncertain_act=order.on_uncertain_act, pauses=pauses)
        if order.fault:
            plant(order.fault, world.member, world)
        return world

    def _seat(self) -> Seat:
        order = self.order
        staleness, alone = Staleness(order.staleness, order.exact), frozenset(order.alone)
        return Seat(order.name, order.process, self.loader.wiring, self.port, self.observers, staleness, alone)


def pacemaker_of(order: NodeOrder, epochs: EpochPublisher) -> Pacemaker:
    """The world's, which publishes the digests of its epochs, and writes them where that is wanted."""
    roster_hash = b"" if order.roster is None else order.roster.content_hash()
    log = digest_log(order.output_path, append=order.life != BEGIN)

    def on_commit(epoch: int, digest: bytes) -> None:
        epochs.publish(epoch, digest)
        if log is not None:
            log.write(epoch, digest)
            log.flush()

    return Pacemaker(DigestChain(roster_hash), order.epochs, on_commit)


def preload(modules: tuple[str, ...], allowance: Allowance) -> None:
    """Import what will be needed; what fails, or may not be loaded, is told when it is."""
    for module in filter(allowance.covers, modules):
        try:
            importlib.import_module(module)
        except Exception as error:  # noqa: PERF203 - each for itself
            _log.info("%s cannot be imported yet: %s", module, error)
