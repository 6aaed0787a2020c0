"""The supervisor's Zenoh session: the processes of a run find one another through it."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable
from typing import Any

import zenoh

from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import Settings, close_session, free_endpoint, open_session
from hierax.schemas.control import Dismiss, encode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value, decode_value, encode_value

KEEPER = "keeper"
"""The keeper's address among the control keys."""

FIND_TIMEOUT_S = 5.0
LOOK_AGAIN_S = 0.02

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
        self._queryable: Any = None
        self._watcher: Any = None
        self._subscriber: Any = None
        if progress is not None:
            self._subscriber = self._session.declare_subscriber(keys.epochs, _teller(progress))

    def serve(self, on_query: Callable[[Value, Callable[[Value], None]], None]) -> None:
        """Answer what is asked of the keeper: `on_query` is given the question, and what gives the answer."""
        key = self._keys.control(KEEPER)

        def answer(query: zenoh.Query) -> None:
            def reply(value: Value) -> None:
                with query:
                    query.reply(key, encode_value(value))

            payload = query.payload
            try:
                question = decode_value(b"" if payload is None else payload.to_bytes(), "question")
            except SchemaError as error:
                reply({"refusal": str(error)})
                return
            on_query(question, reply)

        self._queryable = self._session.declare_queryable(key, answer)

    def stop_serving(self) -> None:
        """Answer nothing any more, and watch nobody."""
        for declared in (self._queryable, self._watcher):
            if declared is not None:
                declared.undeclare()
        self._queryable = self._watcher = None

    def watch(self, on_gone: Callable[[str, str], None]) -> None:
        """Tell of every process of a node that is gone, or cut off: the node's name and the process's token."""

        def changed(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                name, token = str(sample.key_expr).split("/")[-2:]
                on_gone(name, token)

        self._watcher = self._session.liveliness().declare_subscriber(self._keys.alive("*"), changed)

    def dismiss(self, process: str, why: str) -> None:
        """Tell a process, if it can be reached, that nobody needs it any more."""
        try:
            self._session.put(self._keys.control(process), encode_control(Dismiss(why)))
        except zenoh.ZError as error:
            _log.info("%s is not dismissed: %s", process, error)

    def note(self, what: str) -> None:
        """Tell whoever records what happens, if somebody does."""
        try:
            self._session.put(self._keys.notes, encode_value(what))
        except zenoh.ZError as error:
            _log.info("a note is not told: %s", error)

    def close(self) -> None:
        """Close the session."""
        close_session(self._session)


def ask(endpoint: str, question: Value, settings: Settings = None, timeout_s: float = 60.0) -> Value:
    """Ask a launch's keeper something.

    Args:
        endpoint: of its hub.
        question: see `hierax.runtime.launch.requests`.
        settings: Zenoh's own.
        timeout_s: how long the answer may take.

    Raises:
        TransportError: it cannot be reached, or does not answer.
    """
    # a client, as the processes of the run would link to a peer
    try:
        session = open_session((), [endpoint], settings, shared_memory=False, mode="client")
    except TransportError as error:
        raise TransportError(f"the launch at {endpoint} cannot be reached: {error}") from error
    key = Keys("*", "*").control(KEEPER)
    data = encode_value(question)
    patience = time.monotonic() + FIND_TIMEOUT_S
    try:
        while time.monotonic() < patience:  # whom nobody has heard of yet is not waited for by `get`
            for reply in session.get(key, payload=data, timeout=timeout_s):
                if reply.ok is not None:
                    return decode_value(reply.ok.payload.to_bytes(), "answer")
            time.sleep(LOOK_AGAIN_S)
    except (zenoh.ZError, SchemaError) as error:
        raise TransportError(f"the launch at {endpoint} cannot be asked: {error}") from error
    finally:
        close_session(session)
    raise TransportError(f"the launch at {endpoint} does not answer")


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
        progress(epoch)

    return tell
