"""A node's end of what tools see of a launch; theirs is `hierax.runtime.transport.launch_client`."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator

import zenoh

from hierax.runtime.transport.queries import Reply, answer_questions
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

QUESTIONS = 64  # how many questions wait at a node; of more than that, the oldest are not answered

_log = logging.getLogger("hierax")


class InspectionEndpoint:
    """Takes questions to a node in, and shows what it says."""

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
