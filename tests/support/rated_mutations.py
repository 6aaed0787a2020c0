"""Planted mistakes in what survives crashes of hierarchies with rates; each has to be found by killing processes."""

from __future__ import annotations

from typing import Any

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.said import SaidMessages
from hierax.runtime.engine.wiring import Slot
from hierax.schemas.checkpoint import encode_under_way
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message, SaidMessage

FORGET, SAY = RatedEngine._forget, RatedEngine._say_what_it_lacks
GATHER = RatedEngine._gather


def _forgets_what_is_in_force(engine: RatedEngine, header: Header) -> None:
    if header.kind == OBSERVATIONS:
        for kind in (TASKS, CONTEXT):
            engine._unheard.forget(header.sender, kind, header.epoch, header.instance)
    else:
        FORGET(engine, header)


def _forgets_what_was_observed(engine: RatedEngine, header: Header) -> None:
    """As if what comes down in an epoch without a turn said that there is a checkpoint of it."""
    FORGET(engine, header)
    if header.kind in (CONTEXT, TASKS):
        engine._unheard.forget(header.sender, OBSERVATIONS, header.epoch + 2, header.instance)


def _forgets_all(messages: SaidMessages, message: Message) -> SaidMessage:
    return SaidMessage(*message)


def _nothing_under_way(engine: RatedEngine) -> bytes:
    return encode_under_way(engine._remembered, ())


def _sends_before_it_saves(engine: RatedEngine) -> None:
    engine._turned, engine._remembered = engine.epoch, None
    engine._send_context()
    engine._effects.save(engine.epoch, 0, engine.encoded_start, engine.encoded)


def _saves_before_it_knows_what_to_send(engine: RatedEngine) -> None:
    engine._turned, engine._remembered = engine.epoch, None
    engine._effects.save(engine.epoch, 0, engine.encoded_start, engine.encoded)
    engine._send_context()


def senses_anew(engine: RatedEngine, observations: Elements) -> Value:
    """As if nothing was remembered."""
    return super(RatedEngine, engine)._observe(observations)


def _does_not_say_again(engine: RatedEngine, neighbour: str) -> None:
    return


def _says_the_newest_again(engine: RatedEngine, neighbour: str) -> None:
    kept = SaidMessages.to
    try:
        SaidMessages.to = lambda messages, receiver: kept(messages, receiver)[-1:]  # type: ignore[method-assign]
        SAY(engine, neighbour)
    finally:
        SaidMessages.to = kept  # type: ignore[method-assign]


def _does_not_greet(engine: RatedEngine) -> None:
    engine._greets = False


def _saves_without_a_turn(engine: RatedEngine) -> None:
    GATHER(engine)
    if not engine._takes_part:
        engine._turned = engine.epoch
        engine._effects.save(engine.epoch, 0, engine.encoded_start, engine.encoded)


MISTAKES: dict[str, tuple[Any, str, Any]] = {
    "what is in force is forgotten": (RatedEngine, "_forget", _forgets_what_is_in_force),
    "observations are forgotten before the turn that needs them": (RatedEngine, "_forget", _forgets_what_was_observed),
    "what was said is not kept": (SaidMessages, "keep", _forgets_all),
    "what was said is not in the checkpoint": (RatedEngine, "under_way", property(_nothing_under_way)),
    "context is said before the checkpoint": (RatedEngine, "_tell_below", _sends_before_it_saves),
    "the checkpoint lacks what is about to be said": (RatedEngine, "_tell_below", _saves_before_it_knows_what_to_send),
    "nothing is said again": (RatedEngine, "_say_what_it_lacks", _does_not_say_again),
    "only the newest is said again": (RatedEngine, "_say_what_it_lacks", _says_the_newest_again),
    "nobody greets": (RatedEngine, "_greet_first", _does_not_greet),
    "a checkpoint forgets what was gathered": (RatedEngine, "_gather", _saves_without_a_turn),
}
"""What each breaks; a node that senses anew, or a greeting that is not judged, has a test of its own."""


def _overlooks(engine: RatedEngine, slot: Slot, message: Message) -> None:
    return


FORGERIES: dict[str, tuple[Any, str, Any]] = {
    "other observations of the epoch under way overlooked": (RatedEngine, "_compare_taken", _overlooks),
}
"""What somebody else has to say something to be noticed."""
