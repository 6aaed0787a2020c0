"""Both ends of a recording: where a node tells its steps, and the world its epochs, and where a recorder hears all."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh

from hierax.runtime.host.run_secret import certificates_of
from hierax.runtime.transport.access_control import access_control
from hierax.runtime.transport.control import answers_on
from hierax.runtime.transport.overlap import Overlap
from hierax.runtime.transport.port import Sample, TransportError
from hierax.runtime.transport.zenoh_session import LINGER_S, ZenohConfig, await_links, close_session, open_session
from hierax.schemas.access import READER, Access
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.messages import is_lent
from hierax.schemas.values import Value, encode_value

CHANNEL_SIZE = 4096  # how many samples wait for the thread that takes them in; when it is full, their senders wait
QUEUE_BYTES = 512 << 20  # how much may wait for the disk; what is more is dropped, counted and named
BEGINNING_BYTES = 4096  # how much is kept of what is dropped: the header, by which it is named
BEGINNINGS = 16384  # of so much; of what else is dropped until somebody asks only the key is

ANSWER_TIMEOUT_S = 2.0
KNOWN_S = 10.0  # how long it may take until who listens is known in another session
LOOK_S = 0.01
ENDS_S = 10.0  # how long it may take until all is taken in that was heard in a session that is closed

BATCH_BYTES = 16 << 20  # with so much there is nothing to wait for

_log = logging.getLogger("hierax")


class StepPublisher:
    """A node's end: tells steps and rosters while somebody listens, and nothing else."""

    def __init__(self, session: zenoh.Session, keys: Keys, name: str) -> None:
        self._keys, self._name = keys, name
        self._changed = threading.Event()
        self.heard = False  # whether somebody listens
        self.move(session)

    def move(self, session: zenoh.Session) -> None:
        """Tell them in an open session, as soon as who listens is known there."""

        def publisher(key: str) -> Any:
            return session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.BLOCK, priority=zenoh.Priority.DATA
            )

        steps = publisher(self._keys.steps(self._name))
        until_s = time.monotonic() + KNOWN_S
        while self.heard and not steps.matching_status.matching and time.monotonic() < until_s:
            time.sleep(LOOK_S)
        self._steps, self._roster = steps, publisher(self._keys.roster)
        self._listener = steps.declare_matching_listener(self._on_matching)
        self.heard = bool(steps.matching_status.matching)

    def wait(self, timeout_s: float) -> bool:
        if not self.heard:
            self._changed.wait(timeout_s)
        return self.heard

    def _on_matching(self, status: zenoh.MatchingStatus) -> None:
        self.heard = bool(status.matching)
        self._changed.set()

    def step(self, data: bytes) -> None:
        self._put(self._steps, data)

    def roster(self, data: bytes) -> None:
        self._put(self._roster, data)

    def close(self) -> None:
        """Tell nothing any more, in a session that goes on."""
        for declared in (self._listener, self._steps, self._roster):
            with suppress(zenoh.ZError):
                declared.undeclare()

    def _put(self, publisher: Any, data: bytes) -> None:
        try:
            publisher.put(data)
        except zenoh.ZError as error:
            _log.info("a step is not told: %s", error)  # closing: the recorder finds that it lacks


class EpochPublisher:
    """Tells whoever listens each committed epoch and its digest; nothing waits for it."""

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self._key = keys.epochs
        self.move(session)

    def move(self, session: zenoh.Session) -> None:
        """Tell it in an open session."""
        self._publisher = session.declare_publisher(
            self._key, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA_LOW
        )

    def __call__(self, epoch: int, digest: bytes) -> None:
        self._publisher.put(encode_value((epoch, digest)))


def _is_lent(data: bytes) -> bool:
    """Whether only its receiver can read a message: it was sent before its sender knew that somebody listens here, and
    belongs to an epoch before those that are heard as a whole."""
    try:
        return is_lent(data)
    except SchemaError:
        return False  # no message: who takes it in finds out


class _Ear:
    """One session in which all is heard that is said in a run. A thread of its own takes samples in, until the session
    is closed; `on_sample` and `on_token` are told of what is heard where."""

    def __init__(
        self,
        session: zenoh.Session,
        on_sample: Callable[["_Ear", Sample], None],
        on_token: Callable[["_Ear", Sample], None],
    ) -> None:
        self.session = session
        self.living: set[str] = set()  # keys of the processes that live, as heard here
        self.is_closing = False  # whether who lives is no matter any more: as its session closes, nobody does
        self._on_sample, self._on_token = on_sample, on_token

    def listen(self, keys: Keys) -> None:
        """Raises `TransportError` if Zenoh does not let it."""
        try:
            self._channel = self.session.declare_subscriber(keys.everything, zenoh.handlers.FifoChannel(CHANNEL_SIZE))
            liveliness = self.session.liveliness()
            self._tokens = liveliness.declare_subscriber(keys.alive("*"), self._token, history=True)
        except zenoh.ZError as error:
            close_session(self.session)
            raise TransportError(f"cannot listen to the run: Zenoh: {error}") from error
        self._taker = threading.Thread(target=self._take_in, name="hierax-ear", daemon=True)
        self._taker.start()

    def close(self) -> None:
        """Hear nothing more."""
        close_session(self.session)
        self._taker.join(ENDS_S)

    def _take_in(self) -> None:
        while True:
            try:
                sample = self._channel.recv()
            except zenoh.ZError:
                return  # the session is closed
            data = b"" if sample is None else sample.payload.to_bytes()
            key = "" if sample is None else str(sample.key_expr)
            if key and "*" not in key and not _is_lent(data):  # what is said on many keys at once, no node has said
                self._on_sample(self, Sample(time.time_ns(), key, data))

    def _token(self, sample: zenoh.Sample) -> None:
        is_up = sample.kind == zenoh.SampleKind.PUT
        self._on_token(self, Sample(time.time_ns(), str(sample.key_expr), b"", is_up))


class BusTap:
    """A recorder's end: takes in all that is said in a run as it comes, and keeps it until it is asked for.

    Nobody waits for the disk, as threads of its own take samples in; shared memory is copied at once. What the queue
    cannot hold is dropped, and told by `dropped`. It listens at no address, so from another machine it reaches a run
    that cannot reach it. Raises `TransportError` if the hub cannot be reached.
    """

    def __init__(
        self,
        endpoint: str,  # of the run's hub
        keys: Keys,  # of the run
        access: Access,  # who has roles of their own in the run
        zenoh_config: ZenohConfig = None,  # Zenoh's own configuration
        secret: str = "",  # of the run; empty: it is open
    ) -> None:
        self._endpoint, self._keys, self._zenoh_config = endpoint, keys, zenoh_config
        self._access = access_control(keys, access) if certificates_of(secret) else None
        self._queue: deque[Sample] = deque()
        self._waiting = self._held = 0  # bytes: of what is in the queue, and of what only the next ear has heard
        self._dropped: deque[tuple[str, bytes]] = deque()
        self._changed = threading.Condition()
        self._closing = threading.Event()
        self._closed = False
        self._renewing = threading.Lock()
        self._next: _Ear | None = None  # which is about to take the other one's place
        self._overlap = Overlap()  # of both
        self._ear = self._opened(secret)
        self._ear.listen(keys)

    def wait(self, timeout_s: float) -> list[Sample]:
        """What has come since the last time, after a while: a batch costs those who take it in less than one each."""
        with self._changed:
            if self._waiting < BATCH_BYTES and not self._closed:
                self._changed.wait(timeout_s)
            heard, self._queue = self._queue, deque()
            self._waiting = 0
        return list(heard)

    def dropped(self) -> list[tuple[str, bytes]]:
        """Keys, and beginnings of the data, of what was dropped since the last time."""
        with self._changed:
            dropped, self._dropped = self._dropped, deque()
        return list(dropped)

    def ask(self, question: Value, timeout_s: float = ANSWER_TIMEOUT_S) -> Value:
        """Ask the launch's supervisor something, in the session that listens; None: it does not answer."""
        try:
            answers = answers_on(self._ear.session, self._keys.launch, question, timeout_s)
            return next((answer for _, answer in answers), None)
        except (zenoh.ZError, SchemaError):
            return None

    def renew(self, secret: str) -> bool:
        """Go on in another session, with the certificate of this secret; whether it does, as it was not closed before.

        Both listen until the next one is known to all who say something, and what both hear is taken once. Raises
        `TransportError` if the other one cannot be opened; then this one goes on."""
        with self._renewing:
            ear = self._opened(secret)
            with self._changed:
                self._overlap, self._held, self._next = Overlap(), 0, ear
            try:
                ear.listen(self._keys)
                if not self._is_known(ear):
                    ear.close()
                    return False
                self._take_over(ear)
            finally:
                with self._changed:
                    self._next = None
            if self._closing.is_set():
                ear.close()
            return True

    def close(self) -> None:
        """Hear nothing more; what was heard can still be asked for."""
        self._closing.set()
        self._ear.close()
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _opened(self, secret: str) -> _Ear:
        session = open_session(
            (), (self._endpoint,), self._zenoh_config, secret=secret, role=READER, access=self._access
        )
        return _Ear(session, self._on_sample, self._on_token)

    def _is_known(self, ear: _Ear) -> bool:
        """Wait until the next one is known to all, but not for ever; false: all is closed meanwhile."""
        await_links(ear.session, self._ear.session)
        self._closing.wait(LINGER_S)
        until_s = time.monotonic() + KNOWN_S
        while time.monotonic() < until_s:
            with self._changed:
                if self._overlap.is_whole:
                    break
            if self._closing.wait(LOOK_S):
                break
        return not self._closing.is_set()

    def _take_over(self, ear: _Ear) -> None:
        """Have the one before hear nothing more."""
        before = self._ear
        with self._changed:
            before.is_closing = True
        before.close()
        with self._changed:
            self._ear, self._next, self._held = ear, None, 0
            for sample in self._overlap.rest():
                self._add(sample)
            for key in sorted(before.living ^ ear.living):
                self._add(Sample(time.time_ns(), key, b"", key in ear.living))

    def _on_sample(self, ear: _Ear, sample: Sample) -> None:
        with self._changed:
            if ear is self._next:
                if self._has_room(sample):
                    self._held += self._overlap.next(sample)
            elif ear is self._ear:
                if self._next is not None:
                    self._held -= self._overlap.before(sample)
                self._add(sample)

    def _on_token(self, ear: _Ear, sample: Sample) -> None:
        with self._changed:
            if ear.is_closing:
                return
            (ear.living.add if sample.is_up else ear.living.discard)(sample.key)
            if ear is self._ear:
                self._add(sample)

    def _has_room(self, heard: Sample) -> bool:
        """Whether it can wait; else it is dropped."""
        waiting = self._waiting + self._held
        if waiting and waiting + len(heard.data) > QUEUE_BYTES:
            kept_bytes = BEGINNING_BYTES if len(self._dropped) < BEGINNINGS else 0
            self._dropped.append((heard.key, heard.data[:kept_bytes]))
            return False
        return True

    def _add(self, heard: Sample) -> None:
        if self._has_room(heard):
            self._waiting += len(heard.data)
            self._queue.append(heard)
            if self._waiting >= BATCH_BYTES:
                self._changed.notify()
