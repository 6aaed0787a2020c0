"""What has come for a node and was not taken yet, bounded by its bytes.

Zenoh keeps what comes in a queue that is bounded by number, whatever its messages weigh. While the node's thread takes
them one by one, little waits there. While that thread is elsewhere, in an operator for instance, another one looks in
from time to time, drops what nobody wants, and keeps the rest as long as its bytes are within `WAITING_BYTES`. It does
so for the sake of large messages: of small ones it takes a few only, so that who sends many of them waits as ever.

A thread that sleeps in Zenoh's queue is woken by what is put there, which waits where that is full. So that nobody who
interrupts the node is held up, this is done only while the thread sleeps, and it makes room before it goes on.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Container
from time import perf_counter
from typing import Any, cast

import zenoh

from hierax.schemas.limits import MAX_MESSAGE_BYTES

QUEUE_SIZE = 256  # how many messages wait in Zenoh; when it is full, the senders wait
LOOKS = 60  # how often the node's thread looks for a message before it sleeps: some fifty microseconds' worth
AWAY_S = 10e-6  # how long a look takes that gave the processor to somebody else
LEAST_BLIND, MOST_BLIND = 16, 1024  # after which so many waits begin without looking
WAITING_BYTES = MAX_MESSAGE_BYTES  # how much waits beside Zenoh's queue: any message does, if nothing else does
LARGE_BYTES = 1 << 20  # from this on a message is a large one
SMALL_AT_ONCE = 8  # how many small messages are looked through at once, to see what is behind them
ROOM_S = 0.001  # after which who is woken makes more room for what is to wake it
SAMPLE_BYTES = 64 * 1024  # as what a message counts at least: the buffer that Zenoh has read it into is kept with it


class Inbox:
    """The messages for one node, in the order in which they came."""

    def __init__(self, subscriber: zenoh.Subscriber[Any] | None, wake: Callable[[], None]) -> None:
        self.interrupted = False  # whether the node's thread is to look elsewhere; who takes messages ends that
        # to their keys, with a queue of `QUEUE_SIZE`; None: it is yet to come
        self._subscriber = cast("zenoh.Subscriber[Any]", subscriber)
        self._wake = wake  # puts something there; waits while it is full
        self._deciding = threading.Lock()  # held for no longer than it takes to see whether the node's thread sleeps
        self._sleeps = False
        self._wakers = 0  # how many threads are about to look whether it sleeps, or wake it
        self._putting = threading.Lock()  # held by who wakes it
        self._taking = threading.Lock()  # held by whoever takes from Zenoh's queue
        self._kept: deque[zenoh.Sample] = deque()
        self._kept_bytes = 0
        self._taken = 0  # how many the node's thread has asked for
        self._taken_before = 0  # likewise, when the other one looked in last
        self._blind = 0  # in how many of the next waits nothing is looked for
        self._blinded = LEAST_BLIND  # in how many it was last

    @staticmethod
    def handler() -> Any:
        """What a subscriber has to have."""
        return zenoh.handlers.FifoChannel(QUEUE_SIZE)

    def move(self, subscriber: zenoh.Subscriber[Any]) -> None:
        """Take messages from another queue from now on, after those that are in the one before."""
        with self._taking:
            while self._subscriber is not None and (sample := self._subscriber.try_recv()) is not None:
                self._keep(sample, bytes_of(sample))
            self._subscriber = subscriber

    def interrupt(self) -> None:
        """Have the node's thread look at something else than messages; any thread may, and none waits for long."""
        self.interrupted = True
        with self._deciding:  # if it does not sleep, it looks whether it was interrupted before it does
            self._wakers += 1  # first: who ends its sleep looks at that afterwards, so one of both sees the other
            wakes = self._sleeps and self._putting.acquire(blocking=False)
        try:
            if wakes:
                try:
                    self._wake()
                finally:
                    self._putting.release()
        finally:
            with self._deciding:
                self._wakers -= 1

    def take(self, waits: bool) -> zenoh.Sample | None:
        """The next message: looked for a moment, then slept for, if it may wait; None: none, or interrupted.

        In an epoch of small messages the next one is some ten microseconds away, and a thread that sleeps on a
        processor that sleeps takes longer than that to wake. Raises `zenoh.ZError` if the session is closed.
        """
        with self._taking:
            self._taken += 1
            if self._kept:
                sample = self._kept.popleft()
                self._kept_bytes -= bytes_of(sample)
                return sample
            if not waits:
                return self._subscriber.try_recv()
            found = self._look()
            return self._sleep() if found is None else found

    def _look(self) -> zenoh.Sample | None:
        """The next message, if it comes while one looks for it.

        Where others want the processor, who looks holds up the very threads that bring the message, and has to wait
        for its own turn afterwards, while who sleeps is woken at once, as no processor is asleep. So where one look has
        given the processor to somebody who did not bring anything, the next waits begin without looking: twice as many
        as after the last time.
        """
        try_recv = self._subscriber.try_recv
        found = try_recv()
        if found is not None:
            return found
        if self._blind:
            self._blind -= 1
            return None
        before_s = perf_counter()
        for _ in range(LOOKS):
            os.sched_yield()
            found = try_recv()
            if found is not None:
                self._blinded = max(self._blinded - self._blinded // 8, LEAST_BLIND)
                return found
            now_s = perf_counter()
            if now_s - before_s > AWAY_S:
                self._blind = self._blinded = min(2 * self._blinded, MOST_BLIND)
                return None
            before_s = now_s
        return None

    def relieve(self, wanted: Container[str]) -> set[str]:
        """Look after what waits while the node's thread does not; to be called from time to time, by another one.

        Gives the wanted keys of which messages were dropped, as too much waits.
        """
        dropped: set[str] = set()
        if self._taking.acquire(blocking=False):
            try:
                self._look_through(wanted, dropped)
            except zenoh.ZError:
                return dropped  # the session is closed
            finally:
                self._taking.release()
        return dropped

    def _sleep(self) -> zenoh.Sample | None:
        self._sleeps = True
        try:
            return None if self.interrupted else self._subscriber.recv()
        finally:
            self._sleeps = False
            if self._wakers:
                self._make_room()

    def _make_room(self) -> None:
        """Take what is in the way of who wakes the node's thread, until that is done."""
        with self._deciding:
            pass  # who looks just now whether it sleeps may find that it does
        while not self._putting.acquire(timeout=ROOM_S):
            sample = self._subscriber.try_recv()
            if sample is not None:
                self._keep(sample, bytes_of(sample))
        self._putting.release()

    def _keep(self, sample: zenoh.Sample, size: int) -> None:
        self._kept.append(sample)
        self._kept_bytes += size

    def _look_through(self, wanted: Container[str], dropped: set[str]) -> None:
        is_read, self._taken_before = self._taken != self._taken_before, self._taken
        small = SMALL_AT_ONCE if is_read or len(self._kept) >= QUEUE_SIZE else QUEUE_SIZE
        for _ in range(QUEUE_SIZE):
            sample = self._subscriber.try_recv() if small else None
            if sample is None:
                return
            key, size = str(sample.key_expr), bytes_of(sample)
            small -= size < LARGE_BYTES
            if key not in wanted:
                continue
            if self._kept_bytes + size > WAITING_BYTES:
                dropped.add(key)
                continue
            self._keep(sample, size)


def bytes_of(sample: zenoh.Sample) -> int:
    """By how much a message counts for what may wait."""
    return max(len(sample.payload), SAMPLE_BYTES)
