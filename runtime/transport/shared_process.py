"""What nodes that share a process say to one another: it goes in memory, by no network.

A message is encoded all the same: its receiver gets what it would get from another process, and nothing of it can be
changed by its sender afterwards. But its large arrays are handed over as they are, read-only, where nobody can write
into them any more; of others there is one copy.
"""

import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Container
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import zenoh
from numpy.typing import NDArray

from hierax.runtime.transport.inbox import WAITING_BYTES, bytes_of
from hierax.runtime.transport.shared_arrays import root_of
from hierax.schemas.messages import Message, decode_message, encode_message

ROOM = 1024  # how many messages wait for a node; who sends one more waits
ROOM_S = 0.001  # how often it looks whether there is room
PATIENCE_S = 0.1  # how long it waits where too many bytes do: a node that is in no operator has taken some by then

_NUMBER = struct.Struct("<I")


class Handed(NamedTuple):
    """A message on its way to another node of the process."""

    key: str  # that it would have been put on
    data: bytes  # the message, without large arrays
    arrays: list[NDArray[Any]]  # these

    @property
    def size(self) -> int:
        """By how much it counts for what may wait; of an array that several wait for, the memory is there once."""
        return len(self.data) + sum(array.nbytes for array in self.arrays)

    @property
    def message(self) -> Message:
        return decode_message(self.data, lambda told: self.arrays[_NUMBER.unpack(told)[0]])


def hand_over(key: str, message: Message) -> Handed:
    """Raises `SchemaError` if the payload holds something that cannot travel."""
    arrays: list[NDArray[Any]] = []

    def lend(array: NDArray[Any]) -> bytes | None:
        plain = type(array) is np.ndarray and array.flags.c_contiguous and array.flags.aligned
        if not (plain and array.dtype.isnative):
            return None  # it is encoded, as its receiver is to have it in the usual layout
        arrays.append(_frozen(array))
        return _NUMBER.pack(len(arrays) - 1)

    return Handed(key, encode_message(message, lend), arrays)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    """The array if nobody can write into its memory any more, else a copy of it; read-only."""
    frozen: NDArray[Any] = array.copy() if root_of(array).flags.writeable else array.view()
    frozen.flags.writeable = False
    return frozen


Item: TypeAlias = zenoh.Sample | Handed


class SharedInbox:
    """The messages for one of several nodes of a process, by the network or from one another, as they came.

    As `Inbox`, whose place it takes. A node's thread does not look for messages before it sleeps: it would hold up the
    nodes beside it, of which one at a time has the interpreter.
    """

    def __init__(self, wanted: Callable[[], Container[str]]) -> None:
        self.interrupted = False  # whether the node's thread is to look elsewhere; who takes messages ends that
        self._wanted = wanted  # gives the keys of neighbours
        self._queue: SimpleQueue[Item | None] = SimpleQueue()  # None: it was interrupted
        self._stash: deque[Item | None] = deque()
        self._counting = threading.Lock()
        self._bytes = 0
        self._taken = 0  # how many items the node's thread has taken
        self._waited_at = -1  # how many it had when somebody has waited in vain for room
        self._dropped: set[str] = set()
        self._closed = False

    def put(self, handed: Handed, sender: "SharedInbox") -> None:
        """A message from another node of the process, which waits while the queue is full. Meanwhile there is room
        with it: who waits for one another in a circle would never go on. What is more than `WAITING_BYTES` is dropped
        after a moment: what is put aside counts, too, so that in a circle nobody may wait for long."""
        if not self._has_room_soon(handed, sender):
            self._drop(handed.key)
            return
        while self._is_full():
            sender.stash()
            time.sleep(ROOM_S)
        self._add(handed)

    def stash(self) -> None:
        """Put aside what has come; called by the node's thread."""
        with suppress(Empty):
            while True:
                self._stash.append(self._queue.get_nowait())

    def arrive(self, sample: zenoh.Sample) -> None:
        """A message that came by the network, in a thread of Zenoh's. It waits while the queue is full; what is more
        than `WAITING_BYTES` is dropped."""
        if not self._has_room(bytes_of(sample)):
            self._drop(str(sample.key_expr))
            return
        while self._is_full():
            time.sleep(ROOM_S)
        self._add(sample)

    def handler(self) -> Any:
        """What a subscriber has to have."""
        return zenoh.handlers.Callback(self.arrive, indirect=False)

    def move(self, subscriber: zenoh.Subscriber[None]) -> None:
        """What another subscriber calls comes to the same queue."""

    def interrupt(self) -> None:
        """Have the node's thread look at something else than messages; any thread may, and none waits."""
        if not self.interrupted:
            self.interrupted = True
            self._queue.put(None)

    def take(self, waits: bool) -> Item | None:
        """The next message, slept for if it may wait; None: none, or interrupted."""
        while True:
            try:
                item = self._stash.popleft() if self._stash else self._queue.get(waits and not self._closed)
            except Empty:
                return None
            self._taken += 1
            if item is not None:
                with self._counting:
                    self._bytes -= item.size if isinstance(item, Handed) else bytes_of(item)
            if item is not None or waits:
                return item

    def relieve(self, wanted: Container[str]) -> set[str]:
        """The wanted keys of which messages were dropped since the last time, as too much waits."""
        if not self._dropped:
            return set()
        with self._counting:
            dropped, self._dropped = self._dropped, set()
        return {key for key in dropped if key in wanted}

    def close(self) -> None:
        """Take in nothing any more; who waits goes on."""
        self._closed = True
        self.interrupt()

    def _has_room(self, size: int) -> bool:
        """Whether so many bytes more may wait; then they do."""
        with self._counting:
            room = not self._bytes or self._bytes + size <= WAITING_BYTES
            self._bytes += size if room else 0
            return room

    def _has_room_soon(self, handed: Handed, sender: "SharedInbox") -> bool:
        """As `_has_room`, waited for a moment, but only once until the node's thread takes something."""
        until_s = time.monotonic() + PATIENCE_S
        while not self._has_room(handed.size):
            if self._taken == self._waited_at or self._closed or time.monotonic() > until_s:
                self._waited_at = self._taken
                return False
            sender.stash()
            time.sleep(ROOM_S)
        return True

    def _drop(self, key: str) -> None:
        if key in self._wanted():
            with self._counting:
                self._dropped.add(key)

    def _is_full(self) -> bool:
        return self._queue.qsize() >= ROOM and not self._closed

    def _add(self, item: Item) -> None:
        if not self._closed:
            self._queue.put(item)


class Neighbours(dict[str, SharedInbox]):
    """By the token of a node in this process, where it takes its messages from."""

    def __init__(self) -> None:
        super().__init__()
        # Held by who declares something in the session, or takes it back. Zenoh 1.10 tells of a key in full once, and
        # by a number from then on; a thread that declares at the same time may use the number before it was told.
        self.declaring = threading.RLock()
