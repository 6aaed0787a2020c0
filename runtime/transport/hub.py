"""The supervisor's Zenoh session: the processes of a run find one another through it."""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import zenoh

from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import LOOPBACK, Settings, close_session, free_endpoint, open_session
from hierax.schemas.control import Dismiss, encode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.limits import MAX_NUMBER, MAX_QUESTION_BYTES
from hierax.schemas.values import Value, decode_value, encode_value

KEEPER = "keeper"
"""The keeper's address among the control keys."""

FIND_TIMEOUT_S = 5.0
FOUND_TIMEOUT_S = 2.0
"""How long keepers may take to say which runs they keep."""

LOOK_AGAIN_S = 0.02

INTRODUCE_S = 0.3
"""How long it takes at most until everybody has heard of everybody."""

LEAVE_S = 1.0
"""How long processes that are kept elsewhere may take to go when the run is over."""

KNOCK_TIMEOUT_S = 5.0

_TRIES = 5

_log = logging.getLogger("hierax")


class Hub:
    """A session that every process connects to and gossips through; messages of the run don't pass it.

    Args:
        keys: of the run.
        settings: Zenoh's own.
        progress: told the number of each committed epoch, from a thread of Zenoh's.
        host: address of this machine at which others may link; None: this machine's processes only.

    Raises:
        TransportError: Zenoh refuses the settings, or no endpoint could be listened on.
    """

    def __init__(
        self, keys: Keys, settings: Settings, progress: Callable[[int], None] | None, host: str | None = None
    ) -> None:
        self.endpoint, self._session = _listen(settings, host)
        self._keys = keys
        self._settings, self._host = settings, host
        self._living: set[str] = set()
        self._introduces = threading.Lock()
        self._queryable: Any = None
        self._watcher: Any = None
        self._on_gone: Callable[[str, str], None] | None = None
        self._subscriber: Any = None
        if progress is not None:
            self._subscriber = self._session.declare_subscriber(keys.epochs, _teller(progress))

    def serve(self, on_query: Callable[[Value, Callable[[Value], None]], None]) -> None:
        """Answer what is asked of the keeper: `on_query` is given the question, and what gives the answer."""
        key = self._keys.control(KEEPER)

        def answer(query: zenoh.Query) -> None:
            def reply(value: Value) -> None:
                with query:
                    try:
                        query.reply(key, encode_value(value))
                    except zenoh.ZError as error:
                        _log.info("an answer is not sent: %s", error)  # who asked has gone

            try:
                question = read_question(query)
            except SchemaError as error:
                reply({"refusal": str(error)})
                return
            on_query(question, reply)

        self._queryable = self._session.declare_queryable(key, answer)

    def stop_serving(self) -> None:
        """Answer nothing any more, and tell of nobody who goes."""
        self._on_gone = None
        if self._queryable is not None:
            self._queryable.undeclare()
        self._queryable = None

    def watch(self, on_gone: Callable[[str, str], None]) -> None:
        """Tell of every process of a node that is gone, or cut off: the node's name and the process's token."""

        def changed(sample: zenoh.Sample) -> None:
            name, token = str(sample.key_expr).split("/")[-2:]
            if sample.kind == zenoh.SampleKind.DELETE:
                self._living.discard(token)
                tell = self._on_gone
                if tell is not None:
                    tell(name, token)
            else:
                self._living.add(token)

        self._on_gone = on_gone
        liveliness = self._session.liveliness()
        self._watcher = liveliness.declare_subscriber(self._keys.alive("*"), changed, history=True)

    def hears_of(self, process: str) -> bool:
        """Whether a process of a node, by its token, is there and linked to the hub."""
        return process in self._living

    def introduce(self, process: str) -> None:
        """Have two processes link again whose link broke, while both kept theirs to the hub.

        Gossip tells of everybody anew when somebody comes; a session that comes for a moment will do.

        Args:
            process: the token of the one that is missed; where it is not heard of here either, nothing is done.
        """
        if process not in self._living or not self._introduces.acquire(blocking=False):
            return  # it is dead; or all are just being told
        try:
            listen = f"tcp/{self._host}:0" if self._host else LOOPBACK
            session = open_session([listen], [self.endpoint], self._settings, shared_memory=False)
            time.sleep(INTRODUCE_S)
            close_session(session)
        except TransportError as error:
            _log.info("processes are not introduced to one another again: %s", error)
        finally:
            self._introduces.release()

    def dismiss(self, process: str, why: str, again: bool = False) -> None:
        """Tell a process that is kept elsewhere, if it can be reached, that nobody needs it any more.

        Args:
            process: its token.
            why: nobody does.
            again: whether another one is to come in its place.
        """
        try:
            self._session.put(self._keys.control(process), encode_control(Dismiss(why, again)))
        except zenoh.ZError as error:
            _log.info("%s is not dismissed: %s", process, error)

    def dismiss_all(self, reasons: Mapping[str, str]) -> None:
        """Tell processes that are kept elsewhere that the run is over, again and again until they are gone.

        Once is not enough: what is put into a session that is closed then, or on a link that is full, may be lost.

        Args:
            reasons: what they are told, by token.
        """
        patience_s = time.monotonic() + LEAVE_S
        told = dict(reasons)
        while told:
            for process, why in told.items():
                self.dismiss(process, why)
            if time.monotonic() > patience_s:
                return
            time.sleep(LOOK_AGAIN_S)
            told = {process: why for process, why in told.items() if process in self._living}

    def note(self, what: str) -> None:
        """Tell whoever records what happens, if somebody does."""
        try:
            self._session.put(self._keys.notes, encode_value(what))
        except zenoh.ZError as error:
            _log.info("a note is not told: %s", error)

    def close(self) -> None:
        """Close the session."""
        close_session(self._session)


class Caller:
    """Asks the keeper of one launch, through its hub, on the key of that run alone.

    Args:
        endpoint: of the hub.
        settings: Zenoh's own.
        keys: of the run; None: they are found out, which fails where several answer.

    Raises:
        TransportError: the launch cannot be reached.
    """

    def __init__(self, endpoint: str, settings: Settings = None, keys: Keys | None = None) -> None:
        self._endpoint = endpoint
        self._keys = keys
        try:  # a client, as the processes of the run would link to a peer
            self.session = open_session((), [endpoint], settings, shared_memory=False, mode="client")
        except TransportError as error:
            raise TransportError(f"the launch at {endpoint} cannot be reached: {error}") from error

    def ask(self, question: Value, timeout_s: float = 60.0) -> Value:
        """What the keeper answers.

        Args:
            question: see `hierax.runtime.launch.requests`.
            timeout_s: how long the answer may take.

        Raises:
            TransportError: it does not answer.
        """
        patience = time.monotonic() + FIND_TIMEOUT_S
        if self._keys is None:
            self._keys = self._found(patience)
        key = self._keys.control(KEEPER)
        while time.monotonic() < patience:  # whom nobody has heard of yet is not waited for by `get`
            for _, answer in self.get(key, question, timeout_s):
                return answer
            time.sleep(LOOK_AGAIN_S)
        raise TransportError(f"the launch at {self._endpoint} does not answer")

    def get(self, key: str, question: Value, timeout_s: float) -> Iterator[tuple[str, Value]]:
        """The answers on keys that a key matches, as they come, each with the key on which it came.

        Raises:
            TransportError: it cannot be asked, or an answer is none.
        """
        try:
            replies = self.session.get(
                key,
                payload=encode_value(question),
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            for reply in replies:
                if reply.ok is not None and zenoh.KeyExpr(key).includes(reply.ok.key_expr):
                    yield str(reply.ok.key_expr), decode_value(reply.ok.payload.to_bytes(), "answer")
        except (zenoh.ZError, SchemaError) as error:
            raise TransportError(f"the launch at {self._endpoint} cannot be asked: {error}") from error

    def close(self) -> None:
        """Close the session."""
        close_session(self.session)

    def _found(self, patience: float) -> Keys:
        """The keys of the one run whose keeper answers here, and says of itself that it keeps this run."""
        while time.monotonic() < patience:
            found: set[tuple[str, str]] = set()
            for key, answer in self.get(Keys("*", "*").control(KEEPER), {"ask": "ps"}, FOUND_TIMEOUT_S):
                hierarchy, run = key.split("/")[1:3]
                if isinstance(answer, dict) and _says(answer, "hierarchy", hierarchy) and _says(answer, "run", run):
                    found.add((hierarchy, run))
            if len(found) > 1:
                named = ", ".join(sorted(f"{run} ({hierarchy})" for hierarchy, run in found))
                raise TransportError(f"several launches answer at {self._endpoint}, and one at most is there: {named}")
            for hierarchy, run in found:
                return Keys(hierarchy, run)
            time.sleep(LOOK_AGAIN_S)
        raise TransportError(f"the launch at {self._endpoint} does not answer")


def ask(
    endpoint: str, question: Value, settings: Settings = None, timeout_s: float = 60.0, keys: Keys | None = None
) -> Value:
    """Ask a launch's keeper something, in a session for that alone.

    Args:
        endpoint, settings, keys: as `Caller` has them.
        question: see `hierax.runtime.launch.requests`.
        timeout_s: how long the answer may take.

    Raises:
        TransportError: it cannot be reached, or does not answer.
    """
    caller = Caller(endpoint, settings, keys)
    try:
        return caller.ask(question, timeout_s)
    finally:
        caller.close()


def read_question(query: zenoh.Query) -> Value:
    """What is asked.

    Raises:
        SchemaError: it is longer than a question may be, or no value.
    """
    payload = query.payload
    size = 0 if payload is None else len(payload)
    if payload is not None and size > MAX_QUESTION_BYTES:
        raise SchemaError(f"{size} bytes; at most {MAX_QUESTION_BYTES} are allowed", "question")
    return decode_value(b"" if payload is None else payload.to_bytes(), "question")


def _says(answer: dict[str, Value], field: str, what: str) -> bool:
    said = answer.get(field)
    return isinstance(said, str) and said == what


def is_gone(endpoint: str) -> bool:
    """Whether there is no launch at an endpoint any more; not so where its machine cannot be reached.

    Args:
        endpoint: of its hub.
    """
    address, _, port = endpoint.partition("/")[2].rpartition(":")
    try:
        socket.create_connection((address.strip("[]"), int(port)), timeout=KNOCK_TIMEOUT_S).close()
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return False


def _listen(settings: Settings, host: str | None) -> tuple[str, zenoh.Session]:
    """Somebody else may take the free endpoint before we do; then another one is tried."""
    for _ in range(_TRIES - 1):
        endpoint = free_endpoint(host)
        try:
            return endpoint, open_session(listen=[endpoint], settings=settings, shared_memory=False)
        except TransportError:
            continue
    endpoint = free_endpoint(host)
    return endpoint, open_session(listen=[endpoint], settings=settings, shared_memory=False)


def _teller(progress: Callable[[int], None]) -> Callable[[zenoh.Sample], None]:
    def tell(sample: zenoh.Sample) -> None:
        try:
            epoch, _ = decode_value(sample.payload.to_bytes(), "epoch")
        except (SchemaError, ValueError, TypeError):
            return  # not from our world: a bar on a screen is all that it would have moved
        if type(epoch) is int and 0 <= epoch <= MAX_NUMBER:
            progress(epoch)

    return tell
