"""More mistakes made on purpose, each in the place of one function: of owner, records, and what is forged."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.table import Phase
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution import world_member
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.owner import losses, planning
from hierax.runtime.owner.arrivals import Arrivals, Suspicions
from hierax.runtime.owner.context import Answers
from hierax.runtime.owner.inquiry import Inquiry
from hierax.runtime.owner.members import Members
from hierax.runtime.owner.owner import Owner
from hierax.runtime.owner.planning import Planning
from hierax.runtime.recovery import slots
from hierax.runtime.recovery.slots import Slots
from hierax.schemas.control import Dismiss, HandOver, State, TakeOver, Unchanged
from hierax.schemas.messages import Message
from hierax.schemas.roster import Detach, Roster

Mutation = Callable[[], AbstractContextManager[Any]]


def instead(where: Any, name: str, make: Callable[[Any], Any]) -> Mutation:
    """A function in the place of another.

    Args:
        where: class or module.
        name: of the function.
        make: gives it, from the original one.
    """
    return lambda: patch.object(where, name, make(getattr(where, name)))


def nothing(*_: Any) -> None:
    """Do nothing."""


def no(*_: Any) -> bool:
    """Say no."""
    return False


def start_kept(turn: Callable[..., None]) -> Callable[..., None]:
    """A new epoch begins, and what is undone goes back to the start of the one before."""

    def mutant(self: Engine, epoch: int, attempt: int) -> None:
        start, encoded = self.start, self.encoded_start
        turn(self, epoch, attempt)
        if epoch % 2:
            self.start, self.encoded_start = start, encoded

    return mutant


def taken_up_at_once(prepare: Callable[..., None]) -> Callable[..., None]:
    """A version is taken up as soon as it is there."""

    def mutant(self: Engine, wiring: Wiring) -> None:
        prepare(self, wiring)
        if not self.is_world and self.phase is Phase.DONE and wiring.roster in self._prepared:
            self.rewire(wiring.roster)

    return mutant


def before_forgotten(turn: Callable[..., None]) -> Callable[..., None]:
    """What was said in the epoch before is forgotten."""

    def mutant(self: Engine, epoch: int, attempt: int) -> None:
        turn(self, epoch, attempt)
        self._heard_before, self._told_before = {}, {}

    return mutant


def stranger_heard(receive: Callable[..., None]) -> Callable[..., None]:
    """What a stranger says counts as said by a neighbour below."""

    def mutant(self: Engine, message: Message) -> None:
        header = message.header
        if header.sender == "stranger" and self.node.below:
            message = Message(header._replace(sender=self.node.below[0]), message.payload)
        receive(self, message)

    return mutant


def one_slot(write: Callable[..., None]) -> Callable[..., None]:
    """Every record goes to the same slot."""

    def mutant(self: Slots, data: bytes) -> None:
        self._sequence += 1 if self._sequence else 0
        write(self, data)

    return mutant


def instances_overlooked(touched: Callable[[Roster, Roster], frozenset[str]]) -> Callable[..., frozenset[str]]:
    """Neighbours of a new process are told that nothing changes for them."""
    return lambda old, new: touched(replace(old, instances={}), replace(new, instances={}))


def as_now(go_on: Callable[..., None]) -> Callable[..., None]:
    """What is said to be unchanged is taken as it is now, not as in the version that is named."""

    def mutant(self: Member, order: Unchanged) -> None:
        if self.engine is not None:
            newest = max(self.engine.prepared, default=self.engine.wiring.roster)
            go_on(self, order._replace(earlier=newest if newest < order.version else order.earlier))

    return mutant


def dismissed_first(take_effect: Callable[..., dict[str, str]]) -> Callable[..., dict[str, str]]:
    """Processes are told to go before the roster without them is on record."""

    def mutant(self: Members, *arguments: Any) -> dict[str, str]:
        gone = take_effect(self, *arguments)
        for name, process in gone.items():
            self._effects.send_order(process, Dismiss(f"{name}: it goes"))
        return gone

    return mutant


def handed_over_as_it_is(_: Any) -> Callable[..., None]:
    """The state of now is handed over, whichever epoch it is of."""

    def mutant(self: Member, order: HandOver) -> None:
        if self.engine is not None:
            self._report(State(self.name, order.version, self.engine.encoded_start))

    return mutant


def taken_over_in_memory(take_over: Callable[..., None]) -> Callable[..., None]:
    """What is taken over is not written down."""

    def mutant(self: Member, order: TakeOver) -> None:
        kept, self._slots = self._slots, None
        try:
            take_over(self, order)
        finally:
            self._slots = kept

    return mutant


def ready_before_linked(say_ready: Callable[..., None]) -> Callable[..., None]:
    """A process is ready when it has the roster, be its links open or not."""

    def mutant(self: Member, version: int) -> None:
        if self._world is None:
            self._linked.add(version)
        say_ready(self, version)

    return mutant


def not_settled(init: Callable[..., None]) -> Callable[..., None]:
    """An epoch that may have been acted upon is done again with whatever is asked for."""

    def mutant(self: Owner, *arguments: Any, **options: Any) -> None:
        init(self, *arguments, **{**options, "settled": False})

    return mutant


def told_once(join: Callable[..., None]) -> Callable[..., None]:
    """That an operator has raised is said once."""

    def mutant(self: Member, request: str = "") -> None:
        failure, self._failure = self._failure, None
        join(self, request)
        self._failure = failure

    return mutant


def runs_it_now(_: Any) -> Callable[..., bool]:
    """Only the process in force is asked whether it is further than the world."""
    return lambda self, name, process: bool(process == self.members.processes.get(name))


MUTATIONS: dict[str, Mutation] = {
    "start kept when an epoch begins": instead(Engine, "_turn", start_kept),
    "version taken up when it is prepared": instead(Engine, "prepare", taken_up_at_once),
    "contradiction overlooked": instead(Engine, "_check_same", lambda _: nothing),
    "contradiction of the epoch before overlooked": instead(Engine, "_turn", before_forgotten),
    "what is far ahead accepted": instead(Engine, "is_ahead", lambda _: no),
    "stranger heard": instead(Engine, "receive", stranger_heard),
    "one slot": instead(Slots, "write", one_slot),
    "no checksum": lambda: patch.object(slots, "crc32", lambda *_: 0),
    "any checkpoint will do": instead(Arrivals, "_unsound", lambda _: lambda *_: ""),
    "older record as it is": instead(world_member, "_safest", lambda _: lambda record: record),
    "new process overlooked by its neighbours": instead(planning, "touched", instances_overlooked),
    "unchanged as it is now": instead(Member, "_go_on_as", as_now),
    "dismissed before it is recorded": instead(Members, "take_effect", dismissed_first),
    "state handed over as it is": instead(Member, "_hand_over", handed_over_as_it_is),
    "state taken over in memory": instead(Member, "_take_over", taken_over_in_memory),
    "change forgotten with the world's process": instead(Answers, "owe_what_was_made", lambda _: no),
    "ready before the links are open": instead(Member, "_say_ready", ready_before_linked),
    "settled epoch with other nodes": instead(Owner, "__init__", not_settled),
    "plan kept when a process dies": instead(Planning, "redo", lambda _: nothing),
    "those above left when a node is detached": instead(losses, "Detach", lambda _: lambda name, cascade: Detach(name)),
    "older of two blamed": lambda: patch.object(losses, "max", min, create=True),
    "failure told once": instead(Member, "join", told_once),
    "who was cut off left alone": instead(Arrivals, "_on_active", lambda _: nothing),
    "who is ahead left alone": instead(Suspicions, "is_ahead", lambda _: no),
    "what was replaced and is ahead left alone": instead(Arrivals, "_has_had_part", runs_it_now),
    "who is in an attempt of its own left alone": instead(Suspicions, "is_astray", lambda _: no),
    "deadline overlooked": instead(Inquiry, "tick", lambda _: nothing),
    "act repeated in any case": instead(WorldMember, "_should_act", lambda _: lambda *_: True),
}
