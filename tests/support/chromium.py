"""A headless Chromium, told what to do over a pipe (its DevTools protocol)."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

PROGRAM = shutil.which("chromium")

_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--no-first-run", "--disable-extensions", "--disable-background-networking", "--disable-component-update"),
    *("--mute-audio", "--remote-debugging-pipe", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"),
)
_ANSWER_TIMEOUT_S = 60.0


class Page:
    """A page of the browser's.

    Args:
        to, back: file descriptors of the pipes to and from the browser.
        size: of the page, in pixels.
    """

    def __init__(self, to: int, back: int, size: tuple[int, int]) -> None:
        self._to = to
        self._back = back
        self._heard = b""
        self._number = 0
        self._session = ""
        self._events: set[str] = set()
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def go(self, address: str) -> None:
        """Open an address, and wait until its page is there."""
        self.call("Page.enable")
        self.call("Page.navigate", url=address)
        deadline = time.monotonic() + _ANSWER_TIMEOUT_S
        while "Page.loadEventFired" not in self._events:
            self._take("a page", deadline)

    def picture(self) -> bytes:
        """What is seen now, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Have the browser do something; waits for its answer.

        Raises:
            RuntimeError: it refuses, ends, or does not answer in time.
        """
        self._number += 1
        order = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            order["sessionId"] = self._session
        os.write(self._to, json.dumps(order).encode() + b"\0")
        deadline = time.monotonic() + _ANSWER_TIMEOUT_S
        while True:
            said = self._take(method, deadline)
            if said.get("id") == self._number:
                if "error" in said:
                    raise RuntimeError(f"{method}: {said['error']}")
                return dict(said["result"])

    def _take(self, what: str, deadline: float) -> dict[str, Any]:
        """The next thing that the browser says; the names of events are kept."""
        said: dict[str, Any] = json.loads(self._next(what, deadline))
        if "method" in said:
            self._events.add(said["method"])
        return said

    def _next(self, method: str, deadline: float) -> bytes:
        while b"\0" not in self._heard:
            ready, _, _ = select.select([self._back], [], [], max(0.0, deadline - time.monotonic()))
            more = os.read(self._back, 1 << 20) if ready else b""
            if not more:
                raise RuntimeError(f"{method}: the browser {'has ended' if ready else 'does not answer'}")
            self._heard += more
        said, _, self._heard = self._heard.partition(b"\0")
        return said


@contextmanager
def browser(size: tuple[int, int] = (1600, 1000)) -> Iterator[Page]:
    """A browser with one page, of a size in pixels; ends with the block.

    It resolves no names: nothing is fetched from anywhere but this machine.
    """
    assert PROGRAM is not None
    to_read, to = os.pipe()
    back, back_write = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # the browser takes its orders from descriptor 3, and answers on 4
        orders = ["bash", "-c", f'exec 3<&{to_read} 4>&{back_write} "$@"', "bash"]
        process = subprocess.Popen(
            [*orders, PROGRAM, *_OPTIONS, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(to_read, back_write),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_read)
        os.close(back_write)
        try:
            yield Page(to, back, size)
        finally:
            os.close(to)  # that ends it
            os.close(back)
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
