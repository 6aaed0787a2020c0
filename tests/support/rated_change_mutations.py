"""Planted mistakes in how rosters of hierarchies with rates change; simulated faults and changes have to find each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hierax.runtime.engine.effects import Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.table import Phase
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.member import Member
from hierax.runtime.owner.context import EpochProgress
from hierax.runtime.owner.owner import Owner
from hierax.runtime.owner.planning import Planning
from hierax.schemas.checkpoint import decode_under_way, encode_under_way
from hierax.schemas.control import HandOver, State
from hierax.schemas.messages import encode_message
from hierax.schemas.rates import Rates

TAKE_OVER, PREPARE = RatedEngine.take_over, Engine.prepare
RECONSIDER, COMMITTED, FINISH = Planning.reconsider, EpochProgress.committed, Owner.finish


def _counts_when_prepared(engine: RatedEngine, wiring: Wiring) -> None:
    if wiring.place.rates is not None:
        engine._take_rates(wiring.place.rates.as_of(engine.epoch + 1))
    PREPARE(engine, wiring)


def _hands_no_messages_over(engine: RatedEngine, saved: Saved) -> None:
    gathered = decode_under_way(saved.under_way).gathered
    TAKE_OVER(engine, saved._replace(under_way=encode_under_way(None, (), (), gathered)))


def _hands_nothing_gathered_over(engine: RatedEngine, saved: Saved) -> None:
    sensed, said, forgotten, _ = decode_under_way(saved.under_way)
    kept = encode_under_way(sensed, [encode_message(message) for message in said], forgotten)
    TAKE_OVER(engine, saved._replace(under_way=kept))


def _never_drained(progress: EpochProgress, epoch: int) -> None:
    COMMITTED(progress, epoch)
    progress.drained = True


def _changes_beside_what_is_lost(planning: Planning) -> None:
    policy = planning._policy
    planning._policy = replace(policy, rated=False)
    try:
        RECONSIDER(planning)
    finally:
        planning._policy = policy


def _begins_anew_with_each_version(engine: RatedEngine, wiring: Wiring) -> None:
    Engine._wire(engine, wiring)
    engine._instances = {**wiring.below, **wiring.above}
    engine._take_rates(wiring.place.rates or Rates())
    engine._epochs_ahead = 1000


def _hands_over_what_it_has_by_now(member: Member, order: HandOver) -> None:
    engine = member.engine
    if engine is not None and engine.phase is Phase.DONE:
        member._report(State(member.name, order.version, engine.encoded, engine.under_way))


def _over_with_the_world(owner: Owner, drained: bool) -> None:
    FINISH(owner, drained=True)


def _hears_nobody_at_the_end(engine: RatedEngine, attempt: int) -> None:
    engine._greets = True
    engine._greet_first()
    engine._go_on()


MISTAKES: dict[str, tuple[Any, str, Any]] = {
    "rates count when a version is prepared": (RatedEngine, "prepare", _counts_when_prepared),
    "what was said is not handed over": (RatedEngine, "take_over", _hands_no_messages_over),
    "what was gathered is not handed over": (RatedEngine, "take_over", _hands_nothing_gathered_over),
    "a roster takes effect without a drained epoch": (EpochProgress, "committed", _never_drained),
    "who comes is not told with which epoch it begins": (Rates, "since", lambda *_: 0),
    "a change is made beside who is lost": (Planning, "reconsider", _changes_beside_what_is_lost),
    "rates begin anew with a version that leaves them": (RatedEngine, "_wire", _begins_anew_with_each_version),
    "what is handed over is what the node has by now": (Member, "_hand_over", _hands_over_what_it_has_by_now),
    "a run is over with its world": (Owner, "finish", _over_with_the_world),
    "a world that comes back at the end hears nobody": (RatedEngine, "begin_again", _hears_nobody_at_the_end),
}
"""What each breaks."""
