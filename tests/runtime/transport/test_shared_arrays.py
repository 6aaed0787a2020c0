"""Large arrays that are written once and read in place: whose memory it is, and when it is written anew."""

import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from random import Random
from typing import Any

import numpy as np
import pytest
from support.zenoh_ports import open_zenoh

from hierax.runtime.testing.transport import receive
from hierax.runtime.transport import shared_arrays
from hierax.runtime.transport.shared_arrays import ForeignArrayError, Lender, LostArrayError, SharedArrays
from hierax.runtime.transport.zenoh_port import ZenohPort
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Header, Message, encode_message

SIZE = 100_000
LANE = ("ctx", "below")
FORGED = [bytes(16)] * 2  # whose memory it is, and for whom
READER = [bytes(16)]  # of the last pair


def pair(limit: int = 1 << 20) -> tuple[SharedArrays, SharedArrays]:
    """A sender and a receiver that have greeted each other, both in this process."""
    sender, receiver = SharedArrays(limit), SharedArrays(limit)
    assert sender.heard("receiver", receiver.greeting("sender")) is None  # it has not heard of the sender yet
    assert receiver.heard("sender", sender.greeting("receiver")) == sender.lender.secret
    assert sender.heard("receiver", receiver.greeting("sender")) == receiver.lender.secret
    READER[0] = receiver.lender.secret
    return sender, receiver


def pictures() -> Any:
    """Arrays that differ, without end."""
    rng = np.random.default_rng(7)
    while True:
        yield rng.integers(0, 256, SIZE, np.uint8)


def lent(sender: SharedArrays, array: np.ndarray[Any, Any]) -> bytes:
    told = sender.lender.lend(LANE, READER[0], array)
    assert told is not None
    return told


def open_files() -> int:
    """How many descriptors of such memory this process has."""
    gc.collect()
    links = []
    for name in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # that of the listing itself
            links.append(os.readlink(f"/proc/self/fd/{name}"))
    return sum(link.startswith("/memfd:hierax") for link in links)


def test_a_greeting_that_was_overtaken_takes_nothing_back() -> None:
    """One thread makes a greeting, and another one a later greeting, which is sent before it."""
    sender, receiver = SharedArrays(), SharedArrays()
    overtaken = receiver.greeting("sender")
    receiver.heard("sender", sender.greeting("receiver"))
    assert sender.heard("receiver", receiver.greeting("sender")) == receiver.lender.secret
    assert sender.heard("receiver", overtaken) == receiver.lender.secret


def test_greetings_may_be_made_while_others_come() -> None:
    own, others = SharedArrays(), [SharedArrays() for _ in range(8)]
    done = threading.Event()
    failed: list[BaseException] = []

    def greet() -> None:
        try:
            while not done.is_set():
                own.greeting("peer")
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=greet) for _ in range(3)]
    for thread in threads:
        thread.start()
    for other in others * 50:
        own.heard("peer", other.greeting("own"))
    done.set()
    for thread in threads:
        thread.join()
    assert not failed


@pytest.mark.parametrize("dtype", ["<f8", ">f8", "?", "<c16", "<u2"])
@pytest.mark.parametrize("shape", [(20_000,), (100, 200), (10, 20, 100)])
def test_an_array_is_read_as_it_was_and_nobody_writes_into_it(dtype: str, shape: tuple[int, ...]) -> None:
    sender, receiver = pair()
    array = (np.arange(20_000) % 2).astype(dtype).reshape(shape)
    for given in (array, array[::-1], array.T, array[1:]):
        read = receiver.borrow("sender", lent(sender, given))
        assert (read.shape, read.dtype) == (given.shape, given.dtype.newbyteorder("<"))
        assert np.array_equal(read, given)
        assert not read.flags.writeable
        with pytest.raises(ValueError, match="WRITEABLE"):
            read.flags.writeable = True


def test_memory_that_was_asked_for_is_sent_without_a_copy() -> None:
    sender, receiver = pair()
    picture = sender.lender.empty((100, 1000), np.uint8)
    picture[:] = 7
    freeze(picture)
    read = receiver.borrow("sender", lent(sender, picture))
    (segment,) = sender.lender._segments
    segment.bytes[-1] = segment.bytes[shared_arrays._DATA] = 9  # what nobody else does
    assert picture[0, 0] == read[0, 0] == 9
    reshaped = receiver.borrow(
        "sender", lent(sender, picture.reshape(1000, 100))
    )  # in the same memory, it has one shape
    assert (read.shape, reshaped.shape) == ((100, 1000), (1000, 100))
    assert np.array_equal(read.ravel(), reshaped.ravel())


def test_a_part_of_such_memory_or_one_that_may_be_written_to_is_copied() -> None:
    sender, receiver = pair()
    picture = sender.lender.empty(SIZE, np.uint8)
    picture[:] = 7
    read = receiver.borrow("sender", lent(sender, picture))
    picture[:] = 8
    part = receiver.borrow("sender", lent(sender, picture[SIZE // 2 :]))
    picture[:] = 9
    assert (set(read), set(part)) == ({7}, {8})


def freeze(array: np.ndarray[Any, Any]) -> None:
    array.flags.writeable = False
    assert array.base is not None
    array.base.flags.writeable = False


def test_memory_is_written_anew_when_nobody_has_it_and_not_before() -> None:
    sender, receiver = pair()
    kept = None
    for picture, _ in zip(pictures(), range(200), strict=False):
        read = receiver.borrow("sender", lent(sender, picture))
        assert np.array_equal(read, picture)
        kept = (read[10:20], picture[10:20])  # a part is enough to keep it
        del read
    assert len(sender.lender._segments) == 2
    assert kept is not None
    assert np.array_equal(*kept)


def test_who_keeps_arrays_takes_no_more_than_the_limit_and_gets_the_rest_by_the_network() -> None:
    sender, receiver = pair(limit=10 * SIZE)
    kept, told = [], None
    for picture in pictures():
        told = sender.lender.lend(LANE, READER[0], picture)
        if told is None:
            break
        kept.append((receiver.borrow("sender", told), picture))
    assert 5 < len(kept) < 10
    assert all(np.array_equal(read, picture) for read, picture in kept)
    kept.clear()
    assert lent(sender, next(pictures()))


def test_what_was_not_taken_yet_is_not_written_over() -> None:
    sender, receiver = pair()
    first, second = (next(pictures()) for _ in range(2))
    waits = lent(sender, first)
    told = [lent(sender, second) for _ in range(3)]
    assert np.array_equal(receiver.borrow("sender", waits), first)
    assert np.array_equal(receiver.borrow("sender", told[-1]), second)
    assert len(sender.lender._segments) == 4
    for _ in range(9):  # whoever has taken the last one has taken, or will not take, those before
        receiver.borrow("sender", lent(sender, first))
    assert len(sender.lender._segments) == 4


def test_two_processes_of_a_neighbour_are_read_while_one_takes_over() -> None:
    sender, receiver = pair()
    other = SharedArrays()
    before = lent(sender, next(pictures()))
    receiver.heard("sender", other.greeting("receiver"))
    assert other.heard("receiver", receiver.greeting("sender")) == receiver.lender.secret
    after = lent(other, next(pictures()))
    assert np.array_equal(receiver.borrow("sender", before), next(pictures()))
    assert np.array_equal(receiver.borrow("sender", after), next(pictures()))
    with pytest.raises(ForeignArrayError):
        other.borrow("sender", before)


def test_of_neighbours_that_are_gone_nothing_is_left_but_what_somebody_has() -> None:
    receiver, held = SharedArrays(), []
    receiver.lender.lend(LANE, bytes(16), next(pictures()))  # so that its own memory is there
    before = open_files()
    for number in range(6):
        sender = SharedArrays(1 << 20)
        name = f"sender {number}"
        sender.heard("receiver", receiver.greeting(name))
        receiver.heard(name, sender.greeting("receiver"))
        sender.heard("receiver", receiver.greeting(name))
        READER[0] = receiver.lender.secret
        held.append(receiver.borrow(name, lent(sender, next(pictures()))))
        sender.close()
    assert open_files() > before + 6
    receiver.keep({"sender 5"})
    assert list(receiver._neighbours) == list(receiver._readers) == ["sender 5"]
    assert all(np.array_equal(array, next(pictures())) for array in held)
    held.clear()
    del sender
    receiver.keep(())
    assert open_files() <= before


def test_what_is_lost_with_its_link_may_be_written_over_and_is_refused_if_it_comes_after_all() -> None:
    sender, receiver = pair()
    late = lent(sender, next(pictures()))
    sender.lender.forget(LANE)
    lent(sender, next(pictures()))
    assert len(sender.lender._segments) == 1
    with pytest.raises(LostArrayError, match="written over before it was read"):
        receiver.borrow("sender", late)


def test_who_ends_waits_until_its_last_arrays_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_arrays, "TAKEN_S", 60.0)
    sender, receiver = pair()
    array = next(pictures())
    told = lent(sender, array)
    ends = threading.Thread(target=sender.close)
    ends.start()
    assert np.array_equal(receiver.borrow("sender", told), array)
    ends.join()
    assert sender.lender.lend(LANE, READER[0], array) is None


def test_sizes_that_change_do_not_gather_memory() -> None:
    sender, receiver = pair()
    sizes = [*range(20_000, 400_000, 7_000)]
    Random(3).shuffle(sizes)
    before = open_files()
    for size in sizes:
        array = np.full(size, size % 251, np.uint8)
        assert np.array_equal(receiver.borrow("sender", lent(sender, array)), array)
    held = sum(segment.size for segment in sender.lender._segments)
    assert held <= 1 << 20
    assert open_files() - before <= 4 * shared_arrays.MOST_SEGMENTS
    sender.close()
    receiver.close()
    del sender, receiver
    assert open_files() <= before


CONSUMER = """
import sys
from hierax.runtime.transport.shared_arrays import SharedArrays
process, file, secret = sys.argv[1:]
receiver = SharedArrays()
assert not receiver.heard("sender", {"memory": (int(process), int(file), bytes.fromhex(secret)), "number": 1})
assert receiver.greeting("sender")["reads"] == (bytes.fromhex(secret),)
print(receiver.lender.secret.hex(), flush=True)
kept = [receiver.borrow("sender", bytes.fromhex(line)) for line in iter(sys.stdin.readline, "\\n")]
print(sum(int(each[0]) for each in kept), flush=True)
sys.stdin.read()
"""


def test_what_a_killed_receiver_had_is_given_back() -> None:
    sender = SharedArrays(4 * SIZE)
    assert sender.lender.memory is not None
    process, file, secret = sender.lender.memory
    command = [sys.executable, "-c", CONSUMER, str(process), str(file), secret.hex()]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        READER[0] = bytes.fromhex(child.stdout.readline())
        told = [sender.lender.lend(LANE, READER[0], np.full(SIZE, number, np.uint8)) for number in (3, 4, 5)]
        assert None not in told
        child.stdin.write("".join(f"{each.hex()}\n" for each in told if each) + "\n")
        child.stdin.flush()
        assert int(child.stdout.readline()) == 12
        assert sender.lender.lend(LANE, READER[0], np.zeros(SIZE, np.uint8)) is None
        child.send_signal(signal.SIGKILL)
        child.wait()
    assert sender.lender.lend(LANE, READER[0], np.zeros(SIZE, np.uint8)) is not None


PRODUCER = """
import sys
import numpy as np
from hierax.runtime.transport.shared_arrays import SharedArrays
sender = SharedArrays()
process, file, secret = sender.lender.memory
told = sender.lender.lend("lane", bytes.fromhex(sys.argv[1]), np.full(100_000, 7, np.uint8))
print(process, file, secret.hex(), told.hex(), flush=True)
sys.stdin.read()
"""


@contextmanager
def lent_elsewhere(receiver: SharedArrays) -> Iterator[tuple[subprocess.Popen[str], bytes]]:
    """Another process that has lent an array of sevens, and what it tells of that."""
    command = [sys.executable, "-c", PRODUCER, receiver.lender.secret.hex()]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        process, file, secret, told = child.stdout.readline().split()
        receiver.heard("sender", {"memory": (int(process), int(file), bytes.fromhex(secret)), "number": 1})
        try:
            yield child, bytes.fromhex(told)
        finally:
            child.kill()


def test_what_a_killed_sender_has_lent_stays_readable_and_nothing_of_it_is_left_behind() -> None:
    receiver = SharedArrays()
    before = open_files(), {*os.listdir("/dev/shm")}
    with lent_elsewhere(receiver) as (child, told):
        read = receiver.borrow("sender", told)
        child.send_signal(signal.SIGKILL)
        child.wait()
    assert set(read) == {7}
    with pytest.raises(SchemaError, match=r"not there|written over"):
        receiver.borrow("sender", told[:32] + bytes(4) + told[36:])
    assert not [name for name in {*os.listdir("/dev/shm")} - before[1] if "hierax" in name]
    receiver.close()
    del read, receiver
    assert open_files() <= before[0] + 2


def test_this_user_alone_may_open_it() -> None:
    sender, _ = pair()
    lent(sender, next(pictures()))
    assert sender.lender.memory is not None
    for file in (sender.lender.memory[1], sender.lender._segments[0].file):
        assert os.fstat(file).st_mode & 0o777 == 0o600


def test_forged_places_are_refused() -> None:
    """Those of another process: in this one, forged numbers would find what the receiver itself has open."""
    receiver = SharedArrays()
    rng = Random(11)
    with lent_elsewhere(receiver) as (_, told):
        files = open_files()
        for _ in range(3000):
            forged = bytearray(told)
            for _ in range(rng.randint(1, 4)):
                forged[rng.randrange(0 if not rng.randrange(9) else 32, len(forged))] = rng.choice(
                    (0, 1, 0xFF, rng.randrange(256))
                )
            data = bytes(forged[: rng.choice((len(told), len(told), rng.randrange(len(told))))])
            with suppress(SchemaError):
                assert receiver.borrow("sender", data).nbytes <= SIZE
        assert open_files() <= files + 4  # of the segment, and of the board
        with pytest.raises(LostArrayError, match="has told of none"):
            receiver.borrow("another", told)


def test_other_files_are_not_opened(tmp_path: Any) -> None:
    secret = bytes(16)
    (tmp_path / "plain").write_bytes(bytes(1 << 16))
    pipe, _ = files = os.pipe()
    unsealed = os.memfd_create("hierax")
    foreign = os.memfd_create("foreign", os.MFD_ALLOW_SEALING)
    empty = os.memfd_create("hierax", os.MFD_ALLOW_SEALING)
    shared_arrays.fcntl.fcntl(empty, shared_arrays.fcntl.F_ADD_SEALS, shared_arrays._SEALS)
    plain = os.open(tmp_path / "plain", os.O_RDWR)
    os.truncate(unsealed, 1 << 16)
    receiver = SharedArrays()
    try:
        for file in (pipe, unsealed, foreign, empty, plain, 1 << 20, (1 << 64) - 1, -1):
            receiver.heard("sender", {"memory": (os.getpid(), file, secret), "number": 1})
            assert receiver.greeting("sender")["reads"] == (), file
        for memory in (None, (), (1, 2), (1, 2, "3"), ("1", 2, b""), (1.0, 2, b""), {"a": 1}, (1, 2, b"", 4)):
            receiver.heard("sender", {"memory": memory, "reads": memory, "number": 1})
            assert receiver.greeting("sender")["reads"] == (), memory
    finally:
        for file in (*files, unsealed, foreign, empty, plain):
            os.close(file)


def test_without_such_memory_nothing_is_lent(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(os, "memfd_create", refuse)
    lender = Lender()
    assert lender.memory is None
    assert lender.lend(LANE, READER[0], next(pictures())) is None
    assert lender.empty((SIZE,), np.uint8).shape == (SIZE,)


def test_too_many_open_files_end_it_for_this_neighbour(monkeypatch: pytest.MonkeyPatch) -> None:
    sender, receiver = pair()
    told = lent(sender, next(pictures()))
    opened = shared_arrays._open

    def refuse(*_: object) -> Any:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(shared_arrays, "_open", refuse)
    with pytest.raises(LostArrayError, match="Too many open files"):
        receiver.borrow("sender", told)
    monkeypatch.setattr(shared_arrays, "_open", opened)
    assert not sender.heard("receiver", receiver.greeting("sender"))  # from now on by the network


def test_arrays_may_go_in_any_thread_while_others_come() -> None:
    sender, receiver = pair(1 << 24)
    held: list[Any] = [None] * 4
    done = threading.Event()

    def drop(seed: int) -> None:
        rng = Random(seed)
        while not done.is_set():
            held[rng.randrange(len(held))] = None

    threads = [threading.Thread(target=drop, args=[seed]) for seed in range(2)]
    for thread in threads:
        thread.start()
    for number in range(2000):
        value = number % 251
        read = receiver.borrow("sender", lent(sender, np.full(20_000, value, np.uint8)))
        assert read[0] == read[-1] == value
        held[number % 4] = read
    done.set()
    for thread in threads:
        thread.join()
    held.clear()
    del read
    assert len(sender.lender._segments) <= 8
    assert all(segment.claim(sender.lender._board) for segment in sender.lender._segments)


@pytest.fixture
def ports() -> Iterator[dict[str, ZenohPort]]:
    """Two ports over Zenoh that lend each other arrays, and are greeted while the test lasts."""
    opened = open_zenoh([("low", "high")], shared=True)
    yield opened
    for port in opened.values():
        port.close()


def picture_of(number: int) -> Message:
    return Message(Header(CONTEXT, "high", "low", number), ({"picture": np.full(SIZE, number % 251, np.uint8)},))


def forged_place(_: object) -> bytes:
    return shared_arrays._PLACE.pack(FORGED[0], FORGED[1], 3, 0, 1, 1, 4000, SIZE)


def came(ports: dict[str, ZenohPort], number: int) -> Any:
    """The picture that came, and whether it lies in shared memory."""
    message = receive(ports["low"])
    assert message is not None
    assert message.header.epoch == number
    picture = message.payload[0]["picture"]
    assert not picture.flags.writeable
    assert set(picture) == {number % 251}
    return picture


def is_borrowed(array: Any) -> bool:
    while isinstance(array, np.ndarray) and array.base is not None:
        array = array.base
    return isinstance(array, memoryview) and isinstance(array.obj, np.ndarray | shared_arrays.mmap)


def test_ports_lend_large_arrays_and_nothing_else(ports: dict[str, ZenohPort]) -> None:
    for number in range(1, 50):
        ports["high"].send(picture_of(number))
        assert is_borrowed(came(ports, number))
    ports["high"].heard = lambda: True  # somebody else listens, who could not read what is lent
    ports["high"].send(picture_of(50))
    assert not is_borrowed(came(ports, 50))
    ports["high"].heard = lambda: False
    ports["low"].send(Message(Header(OBSERVATIONS, "low", "high", 1), ({"small": np.arange(9)},)))
    small = receive(ports["high"])
    assert small is not None
    assert not is_borrowed(small.payload[0]["small"])


def test_a_port_lets_go_of_who_is_no_neighbour_any_more(ports: dict[str, ZenohPort]) -> None:
    low, high = ports["low"], ports["high"]
    high.send(picture_of(1))
    assert is_borrowed(came(ports, 1))
    shared = low._shared
    assert shared is not None
    assert list(shared._neighbours) == ["high"]
    assert low._readers
    low.link([], [], 1, {}, lambda version: None)
    assert list(shared._neighbours) == ["high"], "until the roster in which it is is over"
    low.unlink(1)
    assert not shared._neighbours
    assert not low._readers


def test_a_forged_place_is_refused_by_a_port_and_the_rest_comes(ports: dict[str, ZenohPort]) -> None:
    high = ports["high"]
    shared = [ports[name]._shared for name in ("high", "low")]
    FORGED[:] = [each.lender.secret for each in shared if each]
    forged = encode_message(picture_of(1), forged_place)
    high._publishers[CONTEXT, "low"].put(forged)
    with pytest.raises(SchemaError, match="place 0 of an array in shared memory does not exist"):
        receive(ports["low"])
    for number in (2, 3):
        high.send(picture_of(number))
        assert is_borrowed(came(ports, number))


def test_what_is_lent_to_another_process_of_a_node_is_left_to_it(ports: dict[str, ZenohPort]) -> None:
    """While one takes over from the other, both hear what is said."""
    high = ports["high"]
    assert high._shared is not None
    lender = high._shared.lender
    high._publishers[CONTEXT, "low"].put(
        encode_message(picture_of(1), lambda array: lender.lend((CONTEXT, "low"), bytes(16), array))
    )
    for number in (2, 3):
        high.send(picture_of(number))
        assert is_borrowed(came(ports, number))


def test_a_port_that_reads_no_shared_memory_refuses_it(ports: dict[str, ZenohPort]) -> None:
    plain = open_zenoh([("low", "high")])
    plain["high"].send(picture_of(1))
    assert not is_borrowed(came(plain, 1))
    plain["high"]._publishers[CONTEXT, "low"].put(encode_message(picture_of(1), forged_place))
    with pytest.raises(SchemaError, match="lies in shared memory, which is not read here"):
        receive(plain["low"])
    for port in plain.values():
        port.close()
