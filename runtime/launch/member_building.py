"""From an order to a member of the run, and what that has from the process's first instant on."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Mapping
from pathlib import Path

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.output_folder import digest_log, open_probes, state_log
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch.faults import plant
from hierax.runtime.launch.frames import BEGIN, NodeOrder
from hierax.runtime.launch.steady import SteadyClock
from hierax.runtime.launch.supervisor_pipe import SupervisorPipe
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.control import OWNER, ControlLine
from hierax.runtime.transport.zenoh_port import EpochPublisher, ZenohPort
from hierax.schemas.control import Control, Dismiss, Order

_log = logging.getLogger("hierax")


def open_observers(order: NodeOrder) -> Observers:
    """The state log and the probes that an order names, open. Raises `HieraxError` if one cannot be opened."""
    output, again = order.output_path, order.life != BEGIN
    probes = open_probes(order.probes, order.name, order.allowance, output, again)
    return Observers(order.name, probes, state_log(output, order.name, again))


def open_slots(order: NodeOrder) -> Slots:
    """Where the node's checkpoints are, or the world's record. Raises `HieraxError` if the file cannot be opened."""
    return Slots(MappedFile(Path(order.checkpoint), order.durability))


def build_member(
    order: NodeOrder, loader: NodeLoader, port: ZenohPort, line: ControlLine, observers: Observers, slots: Slots
) -> Member:
    """The member of a process that is not the world's. Raises `HieraxError` if the order's fault is none."""

    def report(word: Control) -> None:
        line.send(OWNER, word)

    member = Member(_seat(order, loader, port, observers), report, Checkpoints(slots))
    if order.fault:
        plant(order.fault, member, None)
    return member


def _seat(order: NodeOrder, loader: NodeLoader, port: ZenohPort, observers: Observers) -> Seat:
    staleness, alone = Staleness(order.staleness, order.exact), frozenset(order.alone)
    return Seat(order.name, order.process, loader.wiring, port, observers, staleness, alone)


def build_world(
    order: NodeOrder,
    policy: OwnerPolicy,
    loader: NodeLoader,
    port: ZenohPort,
    line: ControlLine,
    observers: Observers,
    slots: Slots,
    pipe: SupervisorPipe,
    pacemaker: Pacemaker,
    processes: Mapping[str, str],
) -> WorldMember:
    """The world's member, not started. Raises `HieraxError` if there is no whole record, or the fault is none."""

    def send_order(process: str, word: Order) -> None:
        if isinstance(word, Dismiss):  # anybody could say it: who is started here hears it from the supervisor
            pipe.dismiss(process, word)
        else:
            line.send(process, word)

    world = WorldMember(
        _seat(order, loader, port, observers),
        send_order,
        pipe,
        slots,
        pacemaker,
        policy,
        SteadyClock(),
        processes,
        order.roster if order.life == BEGIN else None,
        on_uncertain_act=order.on_uncertain_act,
        pauses=order.staleness is not None,  # in free running it has turns
    )
    if order.fault:
        plant(order.fault, world.member, world)
    return world


def pacemaker_of(order: NodeOrder, epochs: EpochPublisher) -> Pacemaker:
    """The world's, which publishes the digests of its epochs, and writes them where that is wanted."""
    roster_hash = b"" if order.roster is None else order.roster.content_hash()
    return Pacemaker(DigestChain(roster_hash), order.epochs, _Commits(order, epochs))


def preload(modules: tuple[str, ...], allowance: Allowance) -> None:
    """Import what will be needed; what fails, or may not be loaded, is told when it is."""
    for module in modules:
        if allowance.covers(module):
            _preload(module)


def _preload(module: str) -> None:
    try:
        importlib.import_module(module)
    except Exception as error:
        _log.info("%s cannot be imported yet: %s", module, error)


class _Commits:
    """What is done with the digest of each committed epoch: it is published, and written where wanted."""

    def __init__(self, order: NodeOrder, epochs: EpochPublisher) -> None:
        self._epochs = epochs
        self._log = digest_log(order.output_path, append=order.life != BEGIN)

    def __call__(self, epoch: int, digest: bytes) -> None:
        self._epochs.publish(epoch, digest)
        if self._log is not None:
            self._log.write(epoch, digest)
            self._log.flush()
