"""A stream of pictures over HTTP on the loopback, as network cameras serve it; it can stall and break off."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

import cv2
import numpy as np

from hierax.nodes.sources.images import Array

_BLOCK_PX, _BITS = 16, 16


def numbered(picture: Array, number: int) -> Array:
    """A picture, gray or RGB, with a number in blocks along its top that survives a JPEG."""
    marked = picture.copy()
    for bit in range(_BITS):
        marked[:_BLOCK_PX, bit * _BLOCK_PX : (bit + 1) * _BLOCK_PX] = 255 * (number >> bit & 1)
    return marked


def number_of(picture: Array) -> int:
    """The number in a picture."""
    half = _BLOCK_PX // 2
    return sum(int(picture[half, bit * _BLOCK_PX + half].mean() > 127) << bit for bit in range(_BITS))


class Stream:
    """Serves pictures over and over, each with the next number, at a rate; every number is sent once, to whoever is
    there. Motion JPEG, a part of ``multipart/x-mixed-replace`` each.

    Attributes:
        url: of the stream.
        sent: how many pictures were sent.
        stalled: while set, nothing is sent, and connections stay.
        refused: while set, connections are closed, and new ones get an error.
        cut: while set, pictures lack their ends.
    """

    def __init__(self, pictures: Sequence[Array], rate_hz: float = 30.0, port: int = 0) -> None:
        self._pictures = pictures
        self._pause_s = 1.0 / rate_hz
        self.sent = 0
        self.connections = 0
        self.stalled, self.refused, self.cut = threading.Event(), threading.Event(), threading.Event()
        self._over = threading.Event()
        self._turn = threading.Lock()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *_: Any) -> None:
                """Nothing is told."""

            def do_GET(self) -> None:
                outer._serve(self)

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/stream.mjpg"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._server.shutdown()
        self._server.server_close()

    def _serve(self, handler: BaseHTTPRequestHandler) -> None:
        if self.refused.is_set():
            handler.send_error(503)
            return
        self.connections += 1
        handler.send_response(200)
        handler.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        handler.end_headers()
        try:
            while not (self._over.is_set() or self.refused.is_set()):
                time.sleep(self._pause_s)
                if not self.stalled.is_set():
                    handler.wfile.write(self._part())
        except OSError:
            return

    def _part(self) -> bytes:
        with self._turn:
            number, self.sent = self.sent, self.sent + 1
        picture = numbered(self._pictures[number % len(self._pictures)], number)
        _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 95])
        if self.cut.is_set():
            data = data[: len(data) // 2]
        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
        return head.encode() + data.tobytes() + b"\r\n"
