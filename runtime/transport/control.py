"""The line between a roster's owner and the processes, and questions and answers, each a value.

What goes along the line may be lost, and is said again."""

import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import zenoh

from hierax.schemas.control import Control, decode_control, encode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys, node_of
from hierax.schemas.limits import MAX_QUESTION_BYTES, MAX_STATE_BYTES
from hierax.schemas.values import Value, decode_value, encode_value

CHANGES = ("change", "await", "renew")  # what is asked on the key of changes; the rest is asked where all may look

_log = logging.getLogger("hierax")

Reply = Callable[[Value], None]  # sends the answer to a question; any thread may call it
OnQuestion = Callable[[Value, Reply], None]


def answer_questions(session: zenoh.Session, key: str, on_question: OnQuestion) -> Any:
    """Have the questions on a key answered; what is no question is refused. Its `undeclare` stops that.

    `on_question` is called with each and what sends the answer, in a thread of Zenoh's: it must not take long."""

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
        self._name = name
        self._keys = keys  # of the run
        self._questions: deque[tuple[Value, Reply]] = deque(maxlen=QUESTIONS)
        self.move(session)

    def move(self, session: zenoh.Session) -> None:
        """Take questions in, and show things, in an open session."""
        key = self._keys.look(self._name)
        self._queryable = answer_questions(session, key, lambda *asked: self._questions.append(asked))
        self._session = session

    def questions(self) -> Iterator[tuple[Value, Reply]]:
        """What was asked since the last time, each with what gives the answer."""
        while self._questions:
            yield self._questions.popleft()

    def close(self) -> None:
        """Take in nothing any more, in a session that goes on."""
        with suppress(zenoh.ZError):
            self._queryable.undeclare()

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


@dataclass(eq=False, repr=False)
class ControlLine:
    """Control messages of one process."""

    session: zenoh.Session  # an open session
    key: str  # where this end is told things; where its last part is ``*``, by nodes, each on the key of its name
    accepts: tuple[type, ...]  # the kinds of messages that are for this end; others are refused, and logged
    heard: Callable[[Control, int], None]  # told each message and its bytes, in Zenoh's thread: must not take long
    most_bytes: int | None = None  # what the session's links carry; None: any. Longer ones are not sent, and logged

    def __post_init__(self) -> None:
        self.move(self.session)

    def move(self, session: zenoh.Session) -> None:
        """Go on in a session: what was heard in the one before is heard there until that is closed."""
        self._subscriber: Any = session.declare_subscriber(self.key, self._on_sample)
        self.session = session

    def send(self, key: str, control: Control) -> None:
        """Send a message to who is told things on a key; any thread may call it."""
        try:
            data = encode_control(control)
        except SchemaError as error:
            _log.warning("not sent: %s on %s: %s", type(control).__name__, key, error)
            return
        if self.most_bytes is not None and len(data) > self.most_bytes:
            what = f"{type(control).__name__} of {len(data)} bytes"
            _log.warning("not sent: %s on %s; low-latency links carry at most %d", what, key, self.most_bytes)
            return
        try:
            self.session.put(
                key,
                data,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        except zenoh.ZError as error:
            _log.info("a control message is not sent: %s", error)  # closing, or cut off: it is said again

    def close(self) -> None:
        """Hear nothing any more, in a session that goes on."""
        with suppress(zenoh.ZError):
            self._subscriber.undeclare()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        try:
            if size > MAX_STATE_BYTES:
                raise SchemaError(f"{size} bytes; at most {MAX_STATE_BYTES} are allowed", "control")
            control = decode_control(sample.payload.to_bytes())
        except SchemaError as error:
            _log.warning("dropped what is no control message: %s", error)
            return
        if not isinstance(control, self.accepts):
            _log.warning("refused %s on %s: nobody says that there", type(control).__name__, self.key)
        elif self.key.endswith("/*") and not _is_said_by(str(sample.key_expr).rpartition("/")[2], control):
            _log.warning("refused %s: %s says it in another one's name", type(control).__name__, sample.key_expr)
        else:
            self.heard(control, size)


def _is_said_by(name: str, control: Control) -> bool:
    """Whether a message is of a node, and of a process of its."""
    process = getattr(control, "process", name)
    return getattr(control, "name", "") == name and node_of(process) == name
