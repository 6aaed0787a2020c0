"""Large arrays between processes of one machine: written once by who sends them, read in place by who receives them.

A sender has segments, each a file in memory without a name (memfd) that this user alone may open, whose size is
sealed: whoever has mapped one cannot lose it under way. Nothing of them is left when the last process that has one open
is gone, however it went. A receiver opens them by way of ``/proc``, and only if the sender's board is there: a page of
the sender's whose secret both have told each other in their greetings. On another machine, in another container or for
another user it is not, and arrays go through the network.

A segment may be written anew when nobody has it any more. Three things say so, and all hold whoever is killed:

- on the board, receivers note the last array that they have taken, one place for each lane; an array that was not taken
  yet keeps its segment;
- a receiver has a shared lock (`flock`) on the segment as long as its array, or a view of it, is there; locks go with
  the process that has them;
- in the sender itself, an array that an operator asked for (`Tick.empty`) keeps its segment as long as it is there.

Each use has a number of its own, which stands in the segment and in what the receiver is told; who finds another one
there came too late: the link was broken in between, and what was under way on it is said again.
"""

import fcntl
import logging
import os
import struct
import threading
import time
import weakref
from collections.abc import Container, Hashable, Iterable
from contextlib import suppress
from math import prod
from mmap import MAP_POPULATE, MAP_SHARED, PROT_READ, PROT_WRITE, mmap
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hierax.schemas.arrays import array_elements, array_head, decode_array
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import LARGE_ARRAY_BYTES, MAX_ARRAY_BYTES

SHARED_BYTES = 128 << 20
"""How much a process lends at most, in segments; what is beyond goes through the network."""

MOST_SEGMENTS = 32  # each takes two descriptors, in the sender and in who receives
TAKEN_S = 0.3  # how long who ends waits until its last arrays are taken: they cannot be opened when it is gone
SPARE = 2  # an array is not put where this many times its size would lie idle

_NAME = "hierax"
_SECRET_BYTES = 16
_DATA = 4096  # where elements begin; before them a segment's own words and, just before, the array's head
_BOARD_BYTES = 1 << 16
_FIRST_PLACE = 4
_USE, _GIVEN_UP = 2, 3  # words of a segment, behind the secret
_PLACE = struct.Struct("<16s16sIIQQQQ")
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
# in the extensions of greetings: process, descriptor and secret of who greets; whose memory it reads, by their secrets
_MEMORY, _READS, _NUMBER = "memory", "reads", "number"
_PROCESSES = 2  # of one neighbour that are remembered: one may come while the one before is still there

_leases = threading.RLock()  # of all segments that are borrowed; an array may go at any time, in any thread

_log = logging.getLogger("hierax")


class LostArrayError(SchemaError):
    """An array is not where it was: its message was under way while the link broke, and counts for nothing."""


class ForeignArrayError(SchemaError):
    """An array is lent to another process of the same node's, which has come before this one or is to come after it."""


def _create(size: int, secret: bytes) -> tuple[int, mmap]:
    """A file in memory that begins with a secret. Raises `OSError` if there is no memory, or no such files."""
    file = os.memfd_create(_NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.fchmod(file, 0o600)
        os.posix_fallocate(file, 0, size)
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, _SEALS)
        memory = mmap(file, size, MAP_SHARED | MAP_POPULATE)
    except BaseException:
        os.close(file)
        raise
    memory[:_SECRET_BYTES] = secret
    return file, memory


def _open(process: int, file: int, secret: bytes, writes: bool = False) -> tuple[int, mmap]:
    """Another process's. Raises `OSError` if it is not there, or is something else."""
    path = f"/proc/{process}/fd/{file}"
    if not os.readlink(path).startswith(f"/memfd:{_NAME} "):  # to open something else might wait, or do something
        raise FileNotFoundError(f"{path} is no file in memory of ours")
    flags, protection = (os.O_RDWR, PROT_READ | PROT_WRITE) if writes else (os.O_RDONLY, PROT_READ)
    opened = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = os.fstat(opened)
        if found.st_uid != os.geteuid() or fcntl.fcntl(opened, fcntl.F_GET_SEALS) & _SEALS != _SEALS:
            raise FileNotFoundError(f"{path} is not this user's, or no sealed one")
        memory = mmap(opened, found.st_size, MAP_SHARED | MAP_POPULATE, protection)
        if memory[:_SECRET_BYTES] != secret:
            raise FileNotFoundError(f"{path} is another one")
    except BaseException as error:
        os.close(opened)
        if isinstance(error, ValueError):  # an empty one
            raise FileNotFoundError(f"{path}: {error}") from error
        raise
    return opened, memory


def root_of(array: NDArray[Any]) -> NDArray[Any]:
    """The array whose memory this one is a view of; itself, where it is none."""
    root = array
    while isinstance(root.base, np.ndarray):
        root = root.base
    return root


class _Segment:
    """A sender's memory for one array at a time."""

    def __init__(self, size: int, secret: bytes) -> None:
        self.file, self._memory = _create(_DATA + size, secret)
        self.size = size
        self.bytes = np.frombuffer(self._memory, np.uint8)
        self.words = memoryview(self._memory).cast("Q")
        self.asked: weakref.ref[NDArray[Any]] | None = None  # of who asked for the memory, while it has it
        self.under_way: dict[int, int] = {}  # number of the array that lies here, by place on the board
        self.writes = False

    def claim(self, board: memoryview) -> bool:
        """Have it alone; whether nobody else has it."""
        if self.asked is not None and self.asked() is not None:
            return False
        if self.is_under_way(board):
            return False
        if not self.writes:
            try:
                fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                return False
        self.writes, self.asked = True, None
        self.under_way.clear()
        self.words[_USE] = 0
        return True

    def is_under_way(self, board: memoryview) -> bool:
        """Whether somebody it was sent to has not taken it yet, and may still do so."""
        return any(board[place] < number for place, number in list(self.under_way.items()))

    def publish(self, use: int) -> None:
        """Let others read it."""
        if self.writes:
            self.words[_USE] = use
            self.writes = False
            fcntl.flock(self.file, fcntl.LOCK_UN)

    def close(self) -> None:
        self.words[_GIVEN_UP] = 1  # who has it mapped gives it back
        os.close(self.file)


class Lender:
    """A sender's side. Any thread may call it."""

    def __init__(self, limit: int = SHARED_BYTES) -> None:
        self.limit = limit  # of the bytes in segments
        self.secret = os.urandom(_SECRET_BYTES)
        self.memory: tuple[int, int, bytes] | None = None  # what receivers are told; None: nothing can be lent
        self._segments: list[_Segment] = []  # what was used last is the last
        self._places: dict[Hashable, int] = {}
        self._number = 0
        self._guard = threading.RLock()
        try:
            self._file, board = _create(_BOARD_BYTES, self.secret)
        except (OSError, AttributeError) as error:
            _log.info("large arrays are not lent: %s", error)
            return
        self._board = memoryview(board).cast("Q")
        self.memory = (os.getpid(), self._file, self.secret)

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = float) -> NDArray[Any]:
        """As `numpy.empty`, of memory that is sent without a copy where there is such."""
        kind = np.dtype(dtype)
        sizes = tuple(shape) if isinstance(shape, Iterable) else (shape,)
        size = prod(sizes) * kind.itemsize
        if self.memory is None or kind.hasobject or not LARGE_ARRAY_BYTES <= size <= MAX_ARRAY_BYTES:
            return np.empty(shape, dtype)
        with self._guard:
            segment = self._segment(size)
            if segment is None:
                return np.empty(shape, dtype)
            array = np.frombuffer(segment.bytes.data[_DATA : _DATA + size], kind)
            segment.asked = weakref.ref(array)
            return array.reshape(sizes)

    def lend(self, lane: Hashable, reader: bytes, array: NDArray[Any]) -> bytes | None:
        """Put an array where a receiver can read it, known by its secret; what it has to be told. None: there is no
        room."""
        with self._guard:
            place = self._places.setdefault(lane, _FIRST_PLACE + len(self._places))
            if self.memory is None or place >= len(self._board):
                return None
            head = np.frombuffer(array_head(array), np.uint8)
            start = _DATA - len(head)
            segment = self._asked(array, head)
            if segment is None:
                segment = self._segment(array.nbytes)
                if segment is None:
                    return None
                segment.bytes[_DATA : _DATA + array.nbytes] = np.frombuffer(array_elements(array), np.uint8)
            if segment.writes:
                segment.bytes[start:_DATA] = head
            self._number += 1
            segment.publish(self._number)
            segment.under_way[place] = self._number
            use = segment.words[_USE]
            numbers = (segment.file, place, use, self._number, start, len(head) + array.nbytes)
            return _PLACE.pack(self.secret, reader, *numbers)

    def forget(self, lane: Hashable) -> None:
        """What is under way on a lane does not arrive."""
        with self._guard:
            place = self._places.get(lane, 0)
            for segment in self._segments:
                segment.under_way.pop(place, None)

    def close(self) -> None:
        """Lend nothing any more; what others have they keep, and what is on its way to them is waited for a moment."""
        until_s = time.monotonic() + TAKEN_S
        while time.monotonic() < until_s and any(each.is_under_way(self._board) for each in list(self._segments)):
            time.sleep(TAKEN_S / 100)
        with self._guard:
            while self._segments:
                self._segments.pop().close()
            if self.memory is not None:
                self.memory = None
                os.close(self._file)

    def _asked(self, array: NDArray[Any], head: NDArray[np.uint8]) -> _Segment | None:
        """The segment that an array is all of, and that nobody writes to any more."""
        root = root_of(array)
        if root.flags.writeable or not (array.flags.c_contiguous and array.dtype.isnative):
            return None
        for segment in self._segments:
            if segment.asked is not None and segment.asked() is root and array.ctypes.data == root.ctypes.data:
                array.flags.writeable = False
                same = segment.writes or np.array_equal(segment.bytes[_DATA - len(head) : _DATA], head)
                return segment if same else None  # it was lent in another shape
        return None

    def _segment(self, size: int) -> _Segment | None:
        """One for an array, for the caller alone."""
        for index, segment in enumerate(self._segments):
            if size <= segment.size <= SPARE * size and segment.claim(self._board):
                self._segments.append(self._segments.pop(index))
                return segment
        step = max(1 << max(size.bit_length() - 3, 0), _DATA)  # sizes that differ a little share segments
        whole = -(-size // step) * step
        if not self._has_room(whole):
            return None
        try:
            segment = _Segment(whole, self.secret)
        except OSError as error:
            _log.warning("large arrays go through the network: %s", error)
            self.limit = 0
            return None
        segment.claim(self._board)
        self._segments.append(segment)
        return segment

    def _has_room(self, size: int) -> bool:
        """Whether there is room, after giving up others that nobody has, where that is enough."""
        for segment in list(self._segments):
            if self._fits(size):
                return True
            if segment.claim(self._board):
                self._segments.remove(segment)
                segment.close()
        return self._fits(size)

    def _fits(self, size: int) -> bool:
        """Whether there is room beside all segments."""
        return sum(each.size for each in self._segments) + size <= self.limit and len(self._segments) < MOST_SEGMENTS


class _Borrowed:
    """A segment of another process's, as long as arrays in it are there."""

    def __init__(self, process: int, file: int, secret: bytes) -> None:
        self._file, memory = _open(process, file, secret)
        self.size = len(memory)
        self._bytes = memoryview(memory)
        self._words = self._bytes.cast("Q") if self.size % 8 == 0 and self.size >= _DATA else None
        self._held: dict[int, weakref.ref[NDArray[Any]]] = {}  # by the references' own identities

    def __del__(self) -> None:
        with suppress(AttributeError, OSError):
            os.close(self._file)

    @property
    def is_given_up(self) -> bool:
        return not self._held and (self._words is None or self._words[_GIVEN_UP] != 0)

    def take(self, use: int) -> NDArray[np.uint8] | None:
        """Its bytes, locked until they and all views of them are gone; None: it is used for something else."""
        array = np.frombuffer(self._bytes, np.uint8)
        with _leases:
            held = weakref.ref(array, self._give_back)
            self._held[id(held)] = held
            try:
                fcntl.flock(self._file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return None
        return None if self._words is None or self._words[_USE] != use else array

    def _give_back(self, gone: "weakref.ref[NDArray[Any]]") -> None:
        with _leases:
            self._held.pop(id(gone), None)
            if not self._held:
                with suppress(OSError):
                    fcntl.flock(self._file, fcntl.LOCK_UN)


class _Neighbour:
    """What a receiver has of one sender's."""

    def __init__(self, process: int, file: int, secret: bytes) -> None:
        self._process, self._secret = process, secret
        opened, board = _open(process, file, secret, writes=True)
        os.close(opened)
        if len(board) != _BOARD_BYTES:
            raise FileNotFoundError("its board is another one")
        self._board = memoryview(board).cast("Q")
        self._segments: dict[int, _Borrowed] = {}

    def borrow(self, file: int, place: int, use: int, number: int, start: int, length: int) -> NDArray[Any]:
        """The array that `Lender.lend` has told of. Raises `SchemaError`, or `OSError` if files cannot be opened."""
        if not _FIRST_PLACE <= place < len(self._board):
            raise SchemaError(f"place {place} of an array in shared memory does not exist", "message")
        segment, taken = self._segments.get(file), None
        if segment is not None:
            taken = segment.take(use)
        if taken is None:  # the sender may have a new one by this number
            segment = self._segments[file] = self._open(file)
            taken = segment.take(use)
        if taken is None:
            raise LostArrayError("an array in shared memory was written over before it was read", "message")
        if start < (_GIVEN_UP + 1) * 8 or start + length > len(taken):
            what = f"bytes {start} to {start + length} of an array in shared memory are not there"
            raise SchemaError(f"{what}: the segment has {len(taken)}", "message")
        array = decode_array(taken.data[start : start + length], "message: an array in shared memory")
        self._board[place] = number
        return array

    def _open(self, file: int) -> _Borrowed:
        self._segments = {each: kept for each, kept in self._segments.items() if not kept.is_given_up}
        try:
            return _Borrowed(self._process, file, self._secret)
        except FileNotFoundError as error:
            raise LostArrayError(f"an array in shared memory is not there: {error}", "message") from error


class SharedArrays:
    """Both sides for one process, by what neighbours say in their greetings; any thread may greet."""

    def __init__(self, limit: int = SHARED_BYTES) -> None:
        self.lender = Lender(limit)
        self._neighbours: dict[str, dict[bytes, _Neighbour]] = {}  # by name, and by the secrets of its processes
        self._unread: set[bytes] = set()  # secrets of those that cannot be read after all
        self._greetings = 0
        self._readers: dict[str, tuple[bytes, int, bytes | None]] = {}  # who said so last, in which greeting
        self._guard = threading.Lock()

    def greeting(self, peer: str) -> dict[str, Any]:
        """What a greeting to a neighbour says beside its own. Its number tells which of two was made later: one thread
        may be overtaken by another between making a greeting and sending it."""
        memory = self.lender.memory or (0, -1, self.lender.secret)
        with self._guard:
            self._greetings += 1
            reads = tuple(secret for secret in self._neighbours.get(peer, {}) if secret not in self._unread)
            return {_MEMORY: memory, _READS: reads, _NUMBER: self._greetings}

    def heard(self, peer: str, said: Any) -> bytes | None:
        """Take in what a neighbour's greeting says; to whom arrays may be lent, by its secret. None: to nobody."""
        memory, reads, number = said.get(_MEMORY), said.get(_READS), said.get(_NUMBER)
        if (
            type(memory) is not tuple
            or tuple(map(type, memory)) != (int, int, bytes)
            or len(memory[2]) != _SECRET_BYTES
            or type(number) is not int
        ):
            return None
        with self._guard:
            process, file, secret = memory
            known = self._neighbours.setdefault(peer, {})
            if file >= 0 and process > 0 and secret not in known:
                with suppress(OSError, OverflowError):  # it is elsewhere
                    known[secret] = _Neighbour(process, file, secret)
            while len(known) > _PROCESSES:
                del known[next(iter(known))]
            teller, latest, reader = self._readers.get(peer, (secret, number, None))
            if teller != secret or number >= latest:
                reader = secret if type(reads) is tuple and self.lender.secret in reads else None
                self._readers[peer] = (secret, number, reader)
            return reader

    def keep(self, peers: Container[str]) -> None:
        """Let go of the memory of all who are no neighbours any more, but for arrays that somebody has yet."""
        with self._guard:
            for peer in [peer for peer in self._neighbours if peer not in peers]:
                self._unread.difference_update(self._neighbours.pop(peer))
                self._readers.pop(peer, None)

    def borrow(self, peer: str, told: bytes) -> NDArray[Any]:
        """The array that a neighbour's message tells of. Raises `SchemaError` if there is none."""
        if len(told) != _PLACE.size:
            raise SchemaError(f"{len(told)} bytes do not say where an array lies; expected {_PLACE.size}", "message")
        secret, reader, *numbers = _PLACE.unpack(told)
        if reader != self.lender.secret:
            raise ForeignArrayError(f"an array of {peer}'s is for another process", "message")
        known = self._neighbours.get(peer, {}).get(secret)
        if known is None:
            raise LostArrayError(f"an array in shared memory of {peer}'s, which has told of none", "message")
        try:
            return known.borrow(*numbers)
        except OSError as error:  # too many open files, for instance: from now on through the network
            self._unread.add(secret)
            _log.warning("large arrays of %s's come through the network from now on: %s", peer, error)
            raise LostArrayError(f"an array in shared memory cannot be read: {error}", "message") from error

    def close(self) -> None:
        self.lender.close()
        self._neighbours.clear()
