"""Questions and answers over Zenoh: a question is a value, and so is each answer."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.limits import MAX_QUESTION_BYTES
from hierax.schemas.values import Value, decode_value, encode_value

Reply = Callable[[Value], None]  # sends the answer to a question; any thread may call it

_log = logging.getLogger("hierax")


def answer_questions(session: zenoh.Session, key: str, on_question: Callable[[Value, Reply], None]) -> Any:
    """Have the questions on a key answered; what is no question is refused. Its `undeclare` stops that.

    `on_question` is called with each and what sends the answer, in a thread of Zenoh's: it must not take long.
    """

    def on_query(query: zenoh.Query) -> None:
        def reply(value: Value) -> None:
            with query:
                try:
                    query.reply(key, encode_value(value))
                except (zenoh.ZError, SchemaError) as error:
                    _log.info("an answer is not sent: %s", error)  # who asked has gone; or it is too long

        try:
            question = _read(query)
        except SchemaError as error:
            reply({"refusal": str(error)})
        else:
            on_question(question, reply)

    return session.declare_queryable(key, on_query)


def answers_on(session: zenoh.Session, key: str, question: Value, timeout_s: float) -> Iterator[tuple[str, Value]]:
    """The answers on matching keys, as they come, each with its key. Raises `zenoh.ZError`, `SchemaError`."""
    replies = session.get(
        key,
        payload=encode_value(question),
        timeout=timeout_s,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    for reply in replies:
        if reply.ok is not None and zenoh.KeyExpr(key).includes(reply.ok.key_expr):
            yield str(reply.ok.key_expr), decode_value(reply.ok.payload.to_bytes(), "answer")


def _read(query: zenoh.Query) -> Value:
    payload = query.payload
    size = 0 if payload is None else len(payload)
    if payload is not None and size > MAX_QUESTION_BYTES:
        raise SchemaError(f"{size} bytes; at most {MAX_QUESTION_BYTES} are allowed", "question")
    return decode_value(b"" if payload is None else payload.to_bytes(), "question")


QUESTIONS = 64  # how many questions wait at a node; of more than that, the oldest are not answered


class InspectionEndpoint:
    """A node's end of what tools see of a launch (theirs is `LaunchClient`): takes questions in, shows what it says."""

    def __init__(self, session: zenoh.Session, keys: Keys, name: str) -> None:
        self._session = session  # an open session
        self._keys = keys  # of the run
        self._questions: deque[tuple[Value, Reply]] = deque(maxlen=QUESTIONS)
        self._queryable = answer_questions(session, keys.look(name), lambda *asked: self._questions.append(asked))

    def questions(self) -> Iterator[tuple[Value, Reply]]:
        """What was asked since the last time, each with what gives the answer."""
        while self._questions:
            yield self._questions.popleft()

    def show(self, kind: str, sender: str, receiver: str, data: bytes) -> None:
        """Show the bytes of a message to who listens; dropped where they cannot go at once."""
        try:
            self._session.put(
                self._keys.seen(kind, sender, receiver),
                data,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_LOW,
            )
        except zenoh.ZError as error:
            _log.info("a copy of a message is not shown: %s", error)
