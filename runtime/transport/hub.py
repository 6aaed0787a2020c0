"""The supervisor's Zenoh session: the processes of a run find one another through it."""

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import zenoh

from hierax.runtime.transport.control import OnQuestion, answer_questions
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import ZenohConfig, close_session, endpoint_at, free_endpoint, open_session
from hierax.schemas.access import LAUNCH
from hierax.schemas.control import Dismiss, encode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys, living
from hierax.schemas.limits import MAX_NUMBER
from hierax.schemas.values import decode_value, encode_value

MAX_LIVING = 1 << 16  # processes that are known to live
INTRODUCE_S = 0.3  # how long it takes at most until everybody has heard of everybody
LEAVE_S = 1.0  # how long processes that are kept elsewhere may take to go when the run is over

LOOK_AGAIN_S = 0.02

_TRIES = 5

_log = logging.getLogger("hierax")


class Hub:
    """A session that every process connects to and gossips through; messages of the run don't pass it.

    `progress` is told each committed epoch and its digest, from a thread of Zenoh's; at `host`, an address of this
    machine, others may link; None: this machine's alone. Raises
    `TransportError` if Zenoh refuses its configuration, or no endpoint could be listened on.
    """

    def __init__(
        self,
        keys: Keys,
        zenoh_config: ZenohConfig,
        progress: Callable[[int, bytes], None] | None,
        host: str | None = None,
        secret: str = "",
        access: Mapping[str, Any] | None = None,
    ) -> None:
        self.secret = secret  # of the run; empty: it is open to whoever reaches it
        self._access = access  # as `open_session` has it
        self._zenoh_config, self._host = zenoh_config, host
        self.endpoint, self._session = self._listen()
        self._keys = keys  # of the run
        self._living: set[str] = set()
        self._introduces = threading.Lock()
        self._queryables: list[Any] = []
        self._watcher: Any = None
        self._on_gone: Callable[[str, str], object] | None = None
        self._recorders: Any = None
        self._notes = self._session.declare_publisher(keys.notes, allowed_destination=zenoh.Locality.REMOTE)
        self._subscribers = []
        if access is not None:
            # the lists of all who belong keep what they say from here; who has none is refused, and so told of
            everything = self._session.declare_subscriber(
                keys.everything, _nothing, allowed_origin=zenoh.Locality.REMOTE
            )
            self._subscribers.append(everything)
        if progress is not None:
            epochs = self._session.declare_subscriber(keys.epochs, _epoch_listener(progress))
            self._subscribers.append(epochs)

    def serve(self, on_look: OnQuestion, on_change: OnQuestion | None = None) -> None:
        """Answer what the supervisor is asked by who looks at the launch, and by who wants it to change: each is given
        the question, and what sends the answer."""
        asked = {self._keys.launch: on_look, self._keys.changes: on_change}
        self._queryables = [answer_questions(self._session, key, each) for key, each in asked.items() if each]

    def stop_serving(self) -> None:
        """Answer nothing any more, and tell of nobody who goes."""
        self._on_gone = None
        while self._queryables:
            self._queryables.pop().undeclare()

    def watch(self, on_gone: Callable[[str, str], object]) -> None:
        """Tell of every process of a node that is gone, or cut off: the node's name and the process's token."""

        def changed(sample: zenoh.Sample) -> None:
            process = living(str(sample.key_expr))
            if process is None:
                return
            name, token = process
            if sample.kind == zenoh.SampleKind.DELETE:
                self._living.discard(token)
                gone = self._on_gone
                if gone is not None:
                    gone(name, token)
            elif len(self._living) < MAX_LIVING:
                self._living.add(token)

        self._on_gone = on_gone
        liveliness = self._session.liveliness()
        self._watcher = liveliness.declare_subscriber(self._keys.alive("*"), changed, history=True)

    def watch_recorders(self, on_change: Callable[[bool], object]) -> None:
        """Tell whenever somebody begins to record, the only ones who hear notes, and when nobody does any more."""
        self._recorders = self._notes.declare_matching_listener(lambda status: on_change(bool(status.matching)))

    def hears_of(self, process: str) -> bool:
        return process in self._living

    def introduce(self, process: str) -> None:
        """Have others link again to a process that is missed; where it is not heard of here either, nothing is done.

        Gossip tells of everybody anew when somebody comes; a session that comes for a moment will do.
        """
        if process not in self._living or not self._introduces.acquire(blocking=False):
            return  # it is dead; or all are just being told
        try:
            session = self._open(endpoint_at(self._host, self.secret), [self.endpoint])
            time.sleep(INTRODUCE_S)
            close_session(session)
        except TransportError as error:
            _log.info("processes are not introduced to one another again: %s", error)
        finally:
            self._introduces.release()

    def dismiss(self, process: str, why: str, again: bool = False) -> None:
        """Tell a process kept elsewhere, if it can be reached, to go, and whether another is to come in its place."""
        try:
            self._session.put(self._keys.control(process), encode_control(Dismiss(why, again)))
        except zenoh.ZError as error:
            _log.info("%s is not dismissed: %s", process, error)

    def dismiss_all(self, reasons: Mapping[str, str]) -> None:
        """Tell processes that are kept elsewhere, by token, that the run is over, again and again until they are gone.

        Once is not enough: what is put into a session that is closed then, or on a link that is full, may be lost.
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
            self._notes.put(encode_value(what))
        except zenoh.ZError as error:
            _log.info("a note is not told: %s", error)

    def close(self) -> None:
        close_session(self._session)

    def _listen(self) -> tuple[str, zenoh.Session]:
        """Somebody else may take the free endpoint before we do; then another one is tried."""
        for _ in range(_TRIES - 1):
            endpoint = free_endpoint(self._host, self.secret)
            with suppress(TransportError):
                return endpoint, self._open(endpoint)
        endpoint = free_endpoint(self._host, self.secret)
        return endpoint, self._open(endpoint)

    def _open(self, endpoint: str, connect: Sequence[str] = ()) -> zenoh.Session:
        config, secret, access = self._zenoh_config, self.secret, self._access
        return open_session([endpoint], connect, config, False, links="told", secret=secret, role=LAUNCH, access=access)


def _nothing(sample: zenoh.Sample) -> None:
    """It was let through, so it is nothing new."""


def _epoch_listener(progress: Callable[[int, bytes], None]) -> Callable[[zenoh.Sample], None]:
    def on_sample(sample: zenoh.Sample) -> None:
        try:
            epoch, digest = decode_value(sample.payload.to_bytes(), "epoch")
        except (SchemaError, ValueError, TypeError):
            return  # not from our world: a bar on a screen is all that it would have moved
        if type(epoch) is int and 0 <= epoch <= MAX_NUMBER and isinstance(digest, bytes):
            progress(epoch, digest)

    return on_sample
