"""Mistakes that engine, owner and recovery could have, each made on purpose while a context lasts.

Each is a plausible misreading of the protocol, put in the place of a few lines of
production code; the simulation has to notice every one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

from hierax.runtime.core.binding import Call
from hierax.runtime.core.node import Tick
from hierax.runtime.engine.engine import Engine
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.owner.owner import Owner
from hierax.runtime.owner.planning import Planning
from hierax.runtime.sim.campaign import Scenarios
from hierax.runtime.sim.process import SimProcess
from hierax.runtime.sim.scenario import CONTRADICT, FAULTS, FORETELL, Scenario
from hierax.schemas.control import Fetch, Prepare
from hierax.schemas.messages import Message
from support import owner_mutations, rated_change_mutations, rated_mutations


@contextmanager
def stale_attempt_accepted() -> Iterator[None]:
    """A message of any attempt of the epoch counts, if its sender's instance is right.

    As every attempt but the first is of a new version of the roster, that is not looked at either.
    """
    receive = Engine.receive

    def mutant(self: Engine, message: Message) -> None:
        header = message.header
        if header.epoch == self.epoch and header.attempt < self.attempt:
            now = header._replace(attempt=self.attempt, roster=self.wiring.roster)
            message = Message(now, message.payload)
        receive(self, message)

    with patch.object(Engine, "receive", mutant):
        yield


@contextmanager
def latest_roster_fetched() -> Iterator[None]:
    """Who lacks a version is given the latest there is, and takes the message for one of that."""
    original = Engine.receive

    def on_fetch(self: Owner, word: Fetch) -> None:
        plan = self.planning.plan
        latest = plan.roster if plan is not None else self.roster
        if word.name in latest.nodes:
            self._effects.send_order(word.process, Prepare(latest.plain()))

    def receive(self: Engine, message: Message) -> None:
        header = message.header
        latest = max(self.prepared, default=0)
        if header.roster > self.wiring.roster and header.roster not in self.prepared and latest > header.roster:
            message = Message(header._replace(roster=latest), message.payload)
        original(self, message)

    with patch.object(Owner, "_on_fetch", on_fetch), patch.object(Engine, "receive", receive):
        yield


@contextmanager
def wrong_belief_rolled_back() -> Iterator[None]:
    """An epoch that is done again begins with the belief as it is now."""
    undo = Engine._undo

    def mutant(self: Engine, attempt: int) -> None:
        belief = self._belief
        undo(self, attempt)
        self.state = self.state._replace(belief=belief)
        self._belief = belief

    with patch.object(Engine, "_undo", mutant):
        yield


@contextmanager
def act_before_commit() -> Iterator[None]:
    """The world acts when it begins an epoch, before it has heard from above."""
    begin = Engine._begin
    hand_on = Engine._hand_on

    def early(self: Engine, world: Any) -> None:
        self._effects.act(self.epoch, self.state.actions)
        begin(self, world)

    def later(self: Engine, *arguments: Any) -> None:
        act, self._effects.act = self._effects.act, lambda epoch, actions: None  # type: ignore[method-assign]
        try:
            hand_on(self, *arguments)
        finally:
            self._effects.act = act  # type: ignore[method-assign]

    with patch.object(Engine, "_begin", early), patch.object(Engine, "_hand_on", later):
        yield


@contextmanager
def act_before_intent() -> Iterator[None]:
    """The world acts, and writes down afterwards that it was going to."""

    def mutant(self: WorldMember, runner: NodeRunner, epoch: int, actions: Any) -> None:
        if runner.engine.node.act is None or not self._should_act(epoch):
            return
        runner.move(epoch, actions)
        self._intended = self._acted = epoch
        self.write_record()

    with patch.object(WorldMember, "act", mutant):
        yield


@contextmanager
def instance_ignored() -> Iterator[None]:
    """Any process that runs a node of that name will do."""
    prepare = Member._prepare

    def on_fetch(self: Owner, word: Fetch) -> None:
        if word.version == self.roster.version and word.name in self.roster.nodes:
            self._effects.send_order(word.process, Prepare(self.roster.plain()))

    def mutant(self: Member, order: Prepare) -> None:
        if self.engine is not None:
            own: Any = dict(order.roster["instances"])
            self.engine.wiring.instance = own.get(self.name, 0)
        prepare(self, order)

    with patch.object(Owner, "_on_fetch", on_fetch), patch.object(Member, "_prepare", mutant):
        yield


@contextmanager
def generator_not_reset() -> Iterator[None]:
    """Random numbers go on where an epoch that is done again had come to."""
    make = Call._tick
    drawn: dict[tuple[int, int, str], int] = {}
    now: list[SimProcess] = []
    run = SimProcess.run

    def running(self: SimProcess, what: Callable[[], None]) -> None:
        now.append(self)
        try:
            run(self, what)
        finally:
            now.pop()

    def mutant(self: Call, epoch: int, time_s: float) -> Tick:
        tick = make(self, epoch, time_s)
        if not now:  # the formal core
            return tick
        key = (id(now[-1]), epoch, f"{self.subject}/{self.operator}")
        drawn[key] = drawn.get(key, 0) + 1
        if drawn[key] > 1:
            tick.rng.bytes(drawn[key])
        return tick

    with patch.object(Call, "_tick", mutant), patch.object(SimProcess, "run", running):
        yield


@contextmanager
def _undone_without(field: str) -> Iterator[None]:
    undo = Engine._undo

    def mutant(self: Engine, attempt: int) -> None:
        kept = getattr(self.state, field)
        undo(self, attempt)
        self.state = self.state._replace(**{field: kept})

    with patch.object(Engine, "_undo", mutant):
        yield


@contextmanager
def policy_not_restored() -> Iterator[None]:
    """An epoch that is done again begins with the policy that was chosen in it."""
    with _undone_without("policy"):
        yield


@contextmanager
def actions_not_restored() -> Iterator[None]:
    """An epoch that is done again begins with the actions that were chosen in it."""
    with _undone_without("actions"):
        yield


@contextmanager
def checkpoint_skipped() -> Iterator[None]:
    """Every other checkpoint is not written."""
    save = Member.save

    def mutant(self: Member, engine: Engine, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        if epoch % 2 == 0:
            save(self, engine, epoch, attempt, start, now)

    with patch.object(Member, "save", mutant):
        yield


@contextmanager
def checkpoint_after_context() -> Iterator[None]:
    """A node sends its context down before it has written its checkpoint."""
    hand_on = Engine._hand_on

    def mutant(self: Engine, *arguments: Any) -> None:
        saved: list[tuple[Any, ...]] = []
        effects: Any = self._effects
        effects.save = lambda *parts: saved.append(parts)
        try:
            hand_on(self, *arguments)
        finally:
            del effects.save
        for parts in saved:
            effects.save(*parts)

    with patch.object(Engine, "_hand_on", mutant):
        yield


@contextmanager
def single_phase() -> Iterator[None]:
    """A version takes effect as soon as everybody was told of it."""
    prepare = Planning._prepare

    def mutant(self: Planning, *arguments: Any) -> None:
        prepare(self, *arguments)
        plan = self.plan
        if plan is not None:
            plan.waiting &= {plan.roster.world}

    with patch.object(Planning, "_prepare", mutant):
        yield


@contextmanager
def attempt_reused() -> Iterator[None]:
    """A world that comes back does the same attempt again."""
    init = Owner.__init__

    def mutant(self: Owner, *arguments: Any, **options: Any) -> None:
        if "attempt" in options:
            options["attempt"] -= 1
        init(self, *arguments, **options)

    with patch.object(Owner, "__init__", mutant):
        yield


@contextmanager
def version_reused() -> Iterator[None]:
    """A version that was dropped, or that only the world's dead process had prepared, is given again."""
    init = Owner.__init__

    def mutant(self: Owner, *arguments: Any, **options: Any) -> None:
        options.pop("highest", None)
        init(self, *arguments, **options)

    with patch.object(Owner, "__init__", mutant):
        yield


@contextmanager
def commit_not_recorded() -> Iterator[None]:
    """What was committed is told before it is written down, where no epoch follows at once."""
    proceed = Owner.proceed

    def mutant(self: Owner) -> None:
        effects: Any = self._effects
        write, effects.write_record = effects.write_record, lambda: None
        begin = effects.begin

        def begins(*arguments: Any) -> None:
            effects.write_record = write
            begin(*arguments)

        effects.begin = begins
        try:
            proceed(self)
        finally:
            del effects.begin, effects.write_record

    with patch.object(Owner, "proceed", mutant):
        yield


@contextmanager
def one_end_says_again() -> Iterator[None]:
    """When a link is mended, only one of its ends says again what may be lost."""
    mended = Member.mended

    def mutant(self: Member, neighbour: str) -> None:
        if self.name < neighbour:
            mended(self, neighbour)

    with patch.object(Member, "mended", mutant):
        yield


@contextmanager
def last_message_said_again() -> Iterator[None]:
    """When a link is mended, each end says only one message again."""

    def mutant(self: Engine, neighbour: str) -> None:
        for receiver, kind in sorted(self._sent)[-1:]:
            if receiver == neighbour:
                self._effects.send(self._sent[receiver, kind])

    with patch.object(Engine, "say_again", mutant):
        yield


@contextmanager
def attempt_kept_that_does_not_count() -> Iterator[None]:
    """Who has done an attempt that nobody has begun goes on from there."""
    with patch.object(Engine, "go_back_to", lambda self, attempt: None):
        yield


@contextmanager
def _broken(mistake: tuple[Any, str, Any]) -> Iterator[None]:
    with patch.object(*mistake):
        yield


RATED = {
    name: partial(_broken, mistake)
    for name, mistake in {
        **rated_mutations.MISTAKES,
        **rated_change_mutations.MISTAKES,
    }.items()
}
"""Those that hierarchies with rates have to show, in which nobody contradicts anybody: that ends a run early."""

RATED_FORGERIES = {name: partial(_broken, mistake) for name, mistake in rated_mutations.FORGERIES.items()}
"""Those that only somebody who speaks in another's name can show."""

_HONEST = tuple(kind for kind in FAULTS if kind not in (FORETELL, CONTRADICT))

MUTATIONS = {
    **owner_mutations.MUTATIONS,
    "stale attempt accepted": stale_attempt_accepted,
    "latest roster fetched instead of the message's": latest_roster_fetched,
    "wrong belief rolled back": wrong_belief_rolled_back,
    "act before commit": act_before_commit,
    "act before intent": act_before_intent,
    "instance ignored": instance_ignored,
    "generator not reset on redo": generator_not_reset,
    "policy not restored": policy_not_restored,
    "actions not restored": actions_not_restored,
    "checkpoint skipped": checkpoint_skipped,
    "checkpoint after context": checkpoint_after_context,
    "single-phase attach": single_phase,
    "attempt number reused": attempt_reused,
    "version number reused": version_reused,
    "commit told before it is recorded": commit_not_recorded,
    "attempt kept that does not count": attempt_kept_that_does_not_count,
    "one end of a mended link says again": one_end_says_again,
    "one message of a mended link said again": last_message_said_again,
    **RATED,
    **RATED_FORGERIES,
}


def scenario_of(name: str, seed: int) -> Scenario:
    """What a seed stands for where a mistake is looked for."""
    faults = _HONEST if name in RATED else FAULTS
    return Scenarios(faults, rated=name in RATED or name in RATED_FORGERIES).draw(seed)
