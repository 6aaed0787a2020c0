"""Sources that go on whether anybody looks or not: devices and streams. The newest frame counts."""

import logging
import threading
import time
from abc import abstractmethod
from typing import NamedTuple

import cv2

from hierax.nodes.sources.files import DataError, told_of
from hierax.nodes.sources.images import Array, await_end, decode_image
from hierax.nodes.sources.played import colours, is_grey, quiet
from hierax.nodes.sources.shots import Seen, Shot, Size, Source, check_size

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 5.0  # before a source is opened again, doubled each time that this fails
REOPENS = " (reopen: true waits for it)"
PATIENCE_S = 5.0  # after so long without a frame it is told that one is waited for

_LOG = logging.getLogger(__name__)
_MAX_MS = 2**31 - 1  # that OpenCV takes


class _Taken(NamedTuple):
    number: int  # counts from 1, in this process
    shot: Shot


class Live(Source):
    """The newest of what a thread takes from the first `shot` on.

    Args:
        name: for errors; timeout_s: after so long without a frame it stalls.
        reopen: whether to open it again when it ends, stalls or is unplugged, in growing pauses, and give no frame
            meanwhile; else that is an error.
    """

    def __init__(self, name: str, timeout_s: float, reopen: bool) -> None:
        self.name = name
        self._timeout_s = timeout_s
        self._reopen = reopen
        self._size: Size | None = None
        self._changed = threading.Condition()
        self._newest: _Taken | None = None
        self._base: int | None = None  # number of the frame before this process's first one
        self._fault = ""
        self._opened = 0
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._capture, name="capture", daemon=True)

    def shot(self, belief: Seen) -> Shot:
        """The newest frame after the belief's; where there is none within the timeout, none, or an error."""
        if self._base is None:
            self._base = belief["frame"]
            self._opened = belief["reopened"] - (belief["index"] == 0)
            self._size = belief["size"]
            self._thread.start()
        with self._changed:
            after = belief["frame"] - self._base
            if not self._changed.wait_for(lambda: self._is_due(after), min(PATIENCE_S, self._timeout_s)):
                self._wait_on(after)
            newest, fault = self._newest, self._fault
        if newest is not None and newest.number > after:
            if newest.shot.image is not None:
                height, width = newest.shot.image.shape[:2]
                self._size = self._size or (width, height)
            frame = self._base + newest.number
            passed_over = frame - belief["frame"] - 1
            return newest.shot._replace(frame=frame, passed_over=passed_over, reopened=self._opened)
        if not self._reopen:
            told = fault or f"no frame for {self._timeout_s:g} s; expected one within source_timeout{self._lacking()}"
            raise DataError(f"{self.name}: {told}{REOPENS}")
        return Shot(belief["frame"], None, self._idle_s(belief), time.time(), reopened=max(self._opened, 0))

    def close(self) -> None:
        """Read no more. A frame that never comes is not waited for."""
        self._closed.set()
        await_end(self._thread)

    @abstractmethod
    def _stream(self) -> str:
        """Have frames taken until that fails; why it did. Called in the thread; what it raises is told likewise."""

    def _idle_s(self, belief: Seen) -> float:
        """The time of an epoch without a frame, by the clock of those that have one."""
        return time.monotonic()

    def _lacking(self) -> str:
        """What a frame that does not come may wait for."""
        return ""

    def _take(self, shot: Shot, count: int = 1) -> None:
        """A frame is there, of so many since the one before. Raises DataError: it is of another size."""
        if shot.image is not None:
            check_size(self.name, shot.image, self._size)
        with self._changed:
            before = 0 if self._newest is None else self._newest.number
            self._newest, self._fault = _Taken(before + count, shot), ""
            self._changed.notify_all()

    def _wait_on(self, after: int) -> None:
        """Wait for the rest of the timeout, and say so: whoever waits for an epoch may have less patience."""
        rest_s = self._timeout_s - PATIENCE_S
        if rest_s > 0.0:
            told = self._fault or f"no frame for {PATIENCE_S:g} s{self._lacking()}"
            _LOG.warning("%s: %s; it is waited for until source_timeout, %g s", self.name, told, self._timeout_s)
            self._changed.wait_for(lambda: self._is_due(after), rest_s)

    def _is_due(self, after: int) -> bool:
        came = self._newest is not None and self._newest.number > after
        return came or bool(self._fault and not self._reopen)

    def _capture(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._closed.is_set():
            before = self._newest
            try:
                fault = self._stream()
            except DataError as error:
                fault = str(error).removeprefix(f"{self.name}: ")
            except Exception as error:  # of a library, which has its own kinds: the thread goes on all the same
                fault = told_of(error)
            with self._changed:
                self._fault = fault
                self._changed.notify_all()
            if not self._reopen:
                return
            pause_s = FIRST_PAUSE_S if self._newest is not before else min(2 * pause_s, LONGEST_PAUSE_S)
            self._closed.wait(pause_s)


class Captured(Live):
    """The newest frame of what `cv2.VideoCapture` opens: the number or path of a device, or a URL."""

    def __init__(self, target: int | str, timeout_s: float, reopen: bool) -> None:
        super().__init__(f"camera {_without_secrets(target)}", timeout_s, reopen)
        self._target = target

    def _stream(self) -> str:
        quiet()
        capture, is_encoded = self._open()
        try:
            if not capture.isOpened():
                return "cannot be opened; expected a device's number, a file, a folder, or a stream's URL"
            self._opened += 1
            grey = is_grey(capture)
            while not self._closed.is_set():
                begun_s = time.monotonic()
                good, image = capture.read()
                now_s, wall_s = time.monotonic(), time.time()
                if not good:
                    if now_s - begun_s >= 0.9 * self._timeout_s:
                        return f"no frame for {self._timeout_s:g} s; expected one within source_timeout"
                    return "gives no more frames; it has ended, or was unplugged"
                frame = self._decoded(image.tobytes()) if is_encoded else colours(image, grey)
                if frame is not None:
                    self._take(Shot(0, frame, now_s, wall_s))
            return "was closed"
        finally:
            capture.release()

    def _open(self) -> tuple[cv2.VideoCapture, bool]:
        """What is captured, and whether as it comes, undecoded: OpenCV scales what it decodes of a stream to the size
        of the first frame, and so nobody would see that it changes. Of motion JPEG each frame is decoded here."""
        if not (isinstance(self._target, str) and "://" in self._target):
            return cv2.VideoCapture(self._target), False
        within = min(int(1000 * self._timeout_s), _MAX_MS)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, within, cv2.CAP_PROP_READ_TIMEOUT_MSEC, within]
        capture = cv2.VideoCapture(self._target, cv2.CAP_FFMPEG, limits)
        codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True)
        return capture, codec == b"MJPG" and capture.set(cv2.CAP_PROP_FORMAT, -1)

    def _decoded(self, data: bytes) -> Array | None:
        """A JPEG's picture; None, with a warning: it is damaged, as may happen under way."""
        try:
            return decode_image(self.name, data)
        except DataError as error:
            _LOG.warning("%s; the frame is left out", error)
            return None


def _without_secrets(target: int | str) -> str:
    """What is opened, as it may be logged: without a URL's user and password, and what its query says, where many
    cameras want them."""
    address, asked, _ = str(target).partition("?")
    scheme, mark, rest = address.partition("://")
    host, slash, path = rest.partition("/")
    return scheme + mark + host.rpartition("@")[2] + slash + path + (asked and "?…")
