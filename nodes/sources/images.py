"""Images of files, checked before they are decoded, and read ahead."""

import re
import struct
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.sources.files import DataError, read_file, write_whole

Array = NDArray[Any]

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".ppm", ".bmp")
MAX_PIXELS = 1 << 25  # of an image: a small file may unpack to gigabytes
AHEAD = 8  # how many images are read ahead at most
END_S = 1.0  # so long the process waits at its end for what is being read

_EXPECTED = "an image: PNG, JPEG, TIFF, BMP or PNM"
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")  # but for those after which no length stands
_JPEG_END = 0xD9

Place = TypeVar("Place")
Read = TypeVar("Read")
_Asked = tuple[Future[Any], Callable[[Any], Any], Any] | None  # to be read, how and where; None: nothing more


def read_image(path: Path) -> Array:
    """An image as uint8, (h, w) gray or (h, w, 3) RGB. Raises DataError: the file is missing, damaged, or has other
    than 8 bits."""
    image = read_deep_image(path)
    check_depth(str(path), image)
    return image


def read_deep_image(path: Path) -> Array:
    """The same, also of 16 bits, as depth has them: uint16."""
    return decode_image(str(path), read_file(path, "an image"))


def check_depth(path: str, image: Array) -> None:
    """See that an image has 8 bits. Raises DataError: it has not."""
    if image.dtype != np.uint8:
        raise DataError(f"{path}: {image.dtype} pixels; expected 8 bits")


def decode_image(path: str, data: bytes) -> Array:
    """What is in a file, or in a message, of 8 or 16 bits; `path`: what it is called in errors."""
    _check_end(path, data)
    size = image_size(data)
    if size is None:  # of other kinds nobody knows how much they unpack to
        raise DataError(f"{path}: cannot be decoded; expected {_EXPECTED}")
    _check_pixels(path, *size)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise DataError(f"{path}: cannot be decoded: {error.err}; expected {_EXPECTED}") from error
    if image is None:
        raise DataError(f"{path}: cannot be decoded; expected {_EXPECTED}")
    _check_pixels(path, image.shape[1], image.shape[0])
    if image.dtype not in (np.uint8, np.uint16) or image.ndim > 3:
        raise DataError(f"{path}: {image.dtype} pixels; expected 8 or 16 bits")
    if image.ndim == 2:
        return image
    return np.ascontiguousarray(image[:, :, 2::-1]) if image.shape[2] >= 3 else np.ascontiguousarray(image[:, :, 0])


def _check_pixels(path: str, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise DataError(f"{path}: has {width}×{height} pixels; expected at most {MAX_PIXELS} in all")


def _check_end(path: str, data: bytes) -> None:
    """Refuse what is cut off: decoders fill in what is missing of a JPEG, and print of a PNG what they think of it.
    Behind its end an image may have whatever it likes, as those of phones have a video."""
    for begin, is_whole, name in ((b"\xff\xd8", _is_whole_jpeg, "JPEG"), (b"\x89PNG", _is_whole_png, "PNG")):
        if data.startswith(begin) and not is_whole(data):
            raise DataError(f"{path}: cut off; expected a whole {name} image")


def _is_whole_jpeg(data: bytes) -> bool:
    return any(marker == _JPEG_END for marker, _ in _jpeg_markers(data))


def _is_whole_png(data: bytes) -> bool:
    at = 8
    while len(data) >= at + 12:  # a chunk's length and kind, what is in it, its sum
        kind = data[at + 4 : at + 8]
        at += 12 + int.from_bytes(data[at : at + 4], "big")
        if kind == b"IEND":
            return at <= len(data)
    return False


class ReadAhead(Generic[Place, Read]):
    """What is read of places in an order, mostly images of files: the next, at most `depth`, are read in a thread while
    one is used. What `read` returns or raises does not depend on it. At its end the process waits for what is being
    read, for a moment, as libraries abort in a thread that is stopped, and for nothing more."""

    def __init__(self, places: Sequence[Place], read: Callable[[Place], Read], depth: int = AHEAD) -> None:
        self._read = read
        self._places = places
        self._depth = depth
        self._begun: dict[int, Future[Read]] = {}
        self._asked: SimpleQueue[_Asked] = SimpleQueue()
        self._thread = threading.Thread(target=_answer, args=(self._asked,), name="read-ahead", daemon=True)
        weakref.finalize(self, _end, self._thread, self._asked)

    def read(self, index: int) -> Read:
        """What is at an index. Raises what its reading raises, DataError for an image."""
        ahead = range(index, min(index + 1 + self._depth, len(self._places)))
        for at in [at for at in self._begun if at not in ahead]:
            self._begun.pop(at).cancel()
        for at in ahead:
            if at not in self._begun:
                self._begun[at] = self._begin(self._places[at])
        return self._begun[index].result()

    def _begin(self, place: Place) -> Future[Read]:
        if self._thread.ident is None:
            self._thread.start()
        future: Future[Read] = Future()
        self._asked.put((future, self._read, place))
        return future


def _answer(asked: SimpleQueue[_Asked]) -> None:
    """Read what is asked for, one by one. In between nothing is held on to, so that readers can be collected."""
    while (work := asked.get()) is not None:
        future, read, place = work
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(read(place))
            except BaseException as error:  # whoever asks for it raises it
                future.set_exception(error)
        del work, future, read, place


def _end(thread: threading.Thread, asked: SimpleQueue[_Asked]) -> None:
    """Read no more: nobody is there to ask for it."""
    with suppress(Empty):
        while True:
            asked.get_nowait()
    asked.put(None)
    await_end(thread)


def await_end(thread: threading.Thread) -> None:
    """Wait until a thread that reads has ended, but not for long."""
    if thread.is_alive() and thread is not threading.current_thread():  # where garbage is collected
        thread.join(END_S)


def write_picture(path: Path, picture: Array) -> None:
    """Write an RGB picture as PNG. The file is whole at every moment at which it is there. Raises DataError: it cannot
    be written."""
    _, content = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    write_whole(path, content.tobytes())


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height as an image's head has them: PNG, JPEG, BMP, PNM and TIFF; None where it has none."""
    try:
        if data.startswith(b"\x89PNG"):
            return struct.unpack_from(">II", data, 16)
        if data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith(b"\xff\xd8"):
            return _jpeg_size(data)
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff_size(data, "<" if data.startswith(b"II") else ">")
        if data[:2] in (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"):
            words = [line.split(b"#")[0] for line in data[2:4096].splitlines()]
            width, height = (int(word) for word in b" ".join(words).split()[:2])
            return width, height
    except (struct.error, ValueError, IndexError):
        return None
    return None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    for marker, at in _jpeg_markers(data):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 3)
            return width, height
    return None


def _jpeg_markers(data: bytes) -> Iterator[tuple[int, int]]:
    """The markers of a JPEG up to its end, each with the place behind it, where most have their length: none of those
    that a thumbnail has. What else stands before a marker is passed over, as by libjpeg: so is what a scan holds."""
    at = 2
    while found := _JPEG_MARKER.search(data, at):
        marker, at = data[found.start() + 1], found.end()
        yield marker, at
        if marker == _JPEG_END:
            return
        at += int.from_bytes(data[at : at + 2], "big")


def _tiff_size(data: bytes, order: str) -> tuple[int, int] | None:
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    sizes: dict[int, int] = {}
    for entry in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * entry)
        if tag in (256, 257):
            sizes[tag] = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 10 + 12 * entry)[0]
    return (sizes[256], sizes[257]) if len(sizes) == 2 else None
