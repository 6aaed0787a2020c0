"""How tools see a launch that runs: the endpoint of a node, and the client that asks it.

Nothing of the run goes through here, and nothing waits for it. Tools do not subscribe to
the keys of edges: what is put there waits for slow receivers, and a tool that its user
has stopped would hold the run up. A node shows copies, which are dropped where they
cannot go at once.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from types import TracebackType
from typing import Any

import zenoh

from hierax.runtime.transport.hub import Caller, read_question
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import Settings
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value, encode_value

QUESTIONS = 64
"""How many questions wait at a window; of more than that, the oldest are not answered."""

LOOK_AGAIN_S = 0.02

Reply = Callable[[Value], None]

_log = logging.getLogger("hierax")


class InspectionEndpoint:
    """A node's end, in its process.

    Args:
        session: an open session.
        keys: of the run.
        name: of the node.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, name: str) -> None:
        self._session = session
        self._keys = keys
        self._key = keys.look(name)
        self._questions: deque[tuple[Value, Reply]] = deque(maxlen=QUESTIONS)
        self._queryable: Any = session.declare_queryable(self._key, self._on_query)

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

    def _on_query(self, query: zenoh.Query) -> None:
        """In a thread of Zenoh's; answered in another one."""

        def reply(value: Value) -> None:
            with query:
                try:
                    query.reply(self._key, encode_value(value))
                except (zenoh.ZError, SchemaError) as error:
                    _log.info("an answer is not sent: %s", error)  # who asked has gone; or it is too long

        try:
            question = read_question(query)
        except SchemaError as error:
            reply({"refusal": str(error)})
            return
        self._questions.append((question, reply))


class LaunchClient:
    """A tool's end: a session of its own, through the launch's hub.

    Args:
        endpoint, settings, keys: as `Caller` has them.

    Raises:
        TransportError: the launch cannot be reached.
    """

    def __init__(self, endpoint: str, settings: Settings = None, keys: Keys | None = None) -> None:
        self._caller = Caller(endpoint, settings, keys)

    def ask_keeper(self, question: Value, timeout_s: float = 60.0) -> Value:
        """Ask the launch's keeper.

        Args:
            question: see `hierax.runtime.launch.requests`.
            timeout_s: how long the answer may take.

        Raises:
            TransportError: it does not answer.
        """
        return self._caller.ask(question, timeout_s)

    def ask_nodes(
        self, keys: Keys, question: Mapping[str, Value], names: Collection[str], timeout_s: float = 2.0
    ) -> dict[str, list[Value]]:
        """Ask nodes at their windows.

        Args:
            keys: of the run.
            question: see `hierax.runtime.launch.inspection_server`.
            names: of the nodes; those that answer sooner are asked again where others are waited for.
            timeout_s: how long all of them may take.

        Returns:
            The answers of those that gave one, by name; of two processes of a node, both.
        """
        patience = time.monotonic() + timeout_s
        answers: dict[str, list[Value]] = {}
        missing = set(names)
        while missing:
            where = keys.look(next(iter(missing)) if len(missing) == 1 else "*")
            left_s = max(patience - time.monotonic(), LOOK_AGAIN_S)
            came: dict[str, list[Value]] = {}
            for key, answer in self._caller.get(where, question, left_s):
                came.setdefault(key.rpartition("/")[2], []).append(answer)
            answers.update({name: came[name] for name in sorted(missing & came.keys())})
            missing -= came.keys()
            if not missing or time.monotonic() >= patience:
                break
            time.sleep(LOOK_AGAIN_S)
        return answers

    def listen(self, key: str, heard: Callable[[str, bytes], None]) -> None:
        """Have every sample on matching keys told, by key and bytes, in a thread of Zenoh's.

        Raises:
            TransportError: Zenoh refuses the key.
        """

        def on_sample(sample: zenoh.Sample) -> None:
            heard(str(sample.key_expr), sample.payload.to_bytes())

        try:
            self._caller.session.declare_subscriber(key, on_sample)
        except zenoh.ZError as error:
            raise TransportError(f"{key!r} is no key to listen to: {error}") from error

    def close(self) -> None:
        """Close the session."""
        self._caller.close()

    def __enter__(self) -> LaunchClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
