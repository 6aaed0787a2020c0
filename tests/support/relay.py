"""Somebody on the way between two machines, who keeps all that passes."""

import socket
import threading
from contextlib import suppress


class Relay:
    """Takes connections on the loopback, and passes on what is said to a port of it and back.

    Attributes:
        port: at which it listens.
        passed: what has passed, both ways.
    """

    def __init__(self, port: int) -> None:
        self._to = port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self.passed = bytearray()
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    def _pass_on(self, come: socket.socket, go: socket.socket) -> None:
        with suppress(OSError), come, go:
            while data := come.recv(65536):
                self.passed += data
                go.sendall(data)
