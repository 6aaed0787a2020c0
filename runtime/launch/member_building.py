"""From an order to a member of the run."""

from __future__ import annotations

import importlib
import logging
from pathlib import Path

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.output_folder import DIGESTS, open_probes, state_log
from hierax.runtime.execution.runner import Log, Pacemaker
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch.faults import plant
from hierax.runtime.launch.frames import BEGIN, NodeOrder
from hierax.runtime.launch.steady import SteadyClock
from hierax.runtime.launch.supervisor_pipe import SupervisorPipe
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.control import OWNER, ControlLine
from hierax.runtime.transport.zenoh_port import EpochPublisher, ZenohPort
from hierax.schemas.control import Control, Dismiss, Order

_log = logging.getLogger("hierax")


def build_member(
    order: NodeOrder,
    loader: NodeLoader,
    port: ZenohPort,
    line: ControlLine,
    pipe: SupervisorPipe,
    epochs: EpochPublisher,
) -> Member:
    """The member that an order asks for.

    Raises:
        HieraxError: a probe, the output folder or the checkpoint cannot be opened.
    """
    member = _built(order, loader, port, line, pipe, epochs)
    member.staleness = Staleness(order.staleness, order.exact)
    member.alone = frozenset(order.alone)
    if order.fault:
        plant(member, order.fault)
    return member


def _built(
    order: NodeOrder,
    loader: NodeLoader,
    port: ZenohPort,
    line: ControlLine,
    pipe: SupervisorPipe,
    epochs: EpochPublisher,
) -> Member:
    output, again = order.output_path, order.life != BEGIN
    slots = _slots(order)
    probes = open_probes(order.probes, order.name, order.allowance, output, again)
    states = state_log(output, order.name, again)
    if order.owner is None:

        def say(word: Control) -> None:
            line.tell(OWNER, word)

        return Member(order.name, order.process, loader.wiring, port, say, slots, probes, states)

    def tell(process: str, word: Order) -> None:
        if isinstance(word, Dismiss):  # anybody could say it: a process that is kept here hears it from its keeper
            pipe.dismiss(process, word)
        else:
            line.tell(process, word)

    roster_hash = b"" if order.roster is None else order.roster.content_hash()
    return WorldMember(
        order.name,
        order.process,
        loader.wiring,
        port,
        tell,
        pipe,
        slots,
        Pacemaker(DigestChain(roster_hash), order.epochs, _Commits(order, epochs)),
        order.owner,
        SteadyClock(),
        on_uncertain_act=order.on_uncertain_act,
        probes=probes,
        states=states,
    )


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


def _slots(order: NodeOrder) -> Slots:
    return Slots(MappedFile(Path(order.checkpoint), order.durability))


class _Commits:
    """What is done with the digest of each committed epoch: it is published, and written where wanted."""

    def __init__(self, order: NodeOrder, epochs: EpochPublisher) -> None:
        output = order.output_path
        self._epochs = epochs
        self._log = None if output is None else Log(output / DIGESTS, append=order.life != BEGIN)

    def __call__(self, epoch: int, digest: bytes) -> None:
        self._epochs.publish(epoch, digest)
        if self._log is not None:
            self._log.write(epoch, digest)
            self._log.flush()
