"""The page on which a session is clicked: served on this machine's loopback alone, to whoever knows its address.

The address has a token, without which nothing is answered: other users of the machine can neither look nor click. Of
what is asked under another host's name nothing is answered either, so that no page of another site gets at it."""

import json
import secrets
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from threading import Lock
from typing import Any

import cv2
import numpy as np

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.clicking.session import Session
from hierax.nodes.tracking.math.geometry import Array

HOST = "127.0.0.1"
_MOST_BYTES = 1000  # of what a page asks for
_TIMEOUT_S = 20.0  # for somebody who connects and says nothing
_CONTENT = "default-src 'self' 'unsafe-inline'"


class Page(ThreadingHTTPServer):
    """Serves a session at a port, 0 for any that is free. Raises DataError: another process listens at the port."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(24)
        self.lock = Lock()
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise DataError(f"--port {port}: {error.strerror}; expected a free port, or none for any") from error

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    def until_done(self) -> None:
        """Serve it until every object is accepted or left out."""
        with self:
            self.serve_forever(poll_interval=0.1)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Who goes away before he is answered is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: Page
    timeout = _TIMEOUT_S

    def do_GET(self) -> None:
        """The page, its pictures, and what is clicked so far."""
        name, session = self._asked(), self.server.session
        if name == "":
            self._answer("text/html; charset=utf-8", files(__package__).joinpath("page.html").read_bytes())
        elif name == "picture.png":
            self._answer("image/png", _png(session.image))
        elif name == "model.png":
            with self.server.lock:
                self._answer("image/png", _png(session.model_picture()))
        elif name == "state":
            with self.server.lock:
                self._answer("application/json", json.dumps(session.state()).encode())
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Something is clicked."""
        length = self.headers.get("Content-Length", "")
        if self._asked() != "do" or not (length.isdecimal() and int(length) <= _MOST_BYTES):
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        try:
            asked = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict):
            self.send_error(HTTPStatus.BAD_REQUEST)
            return
        session = self.server.session
        with self.server.lock:
            session.do(asked)
            self._answer("application/json", json.dumps(session.state()).encode())
        if session.done:
            self.server.shutdown()

    def log_message(self, format: str, *args: object) -> None:
        """Nobody wants to read it."""

    def _asked(self) -> str | None:
        """What is asked for; None where that is nobody's business."""
        token, _, name = self.path.removeprefix("/").partition("?")[0].partition("/")
        known = secrets.compare_digest(token.encode(), self.server.token.encode())
        return name if known and self.headers.get("Host") == f"{HOST}:{self.server.server_port}" else None

    def _answer(self, kind: str, content: bytes) -> None:
        self.send_response(HTTPStatus.OK)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Cache-Control", "no-store"),
            ("Content-Security-Policy", _CONTENT),
            ("Referrer-Policy", "no-referrer"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)


def _png(picture: Array) -> bytes:
    stored = picture if picture.ndim == 2 else picture[..., ::-1]
    content: bytes = cv2.imencode(".png", np.ascontiguousarray(stored))[1].tobytes()
    return content
