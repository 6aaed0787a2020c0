"""What a browser draws of `hierax view`."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

from support import chromium
from support.launched import Command
from support.pixels import Picture, decoded

TIMEOUT_S = 120.0


def check_seen(
    folder: Path, size: tuple[int, int], lacking: Callable[[Picture], list[str]], said: str, *arguments: str
) -> None:
    """Have a browser show what `hierax view` serves, until nothing lacks in its picture.

    Args: folder: for the picture; size: of the page, pixels; lacking: what is not to be seen in a picture of it of that
        which should; said: what the viewer says when there is something to be seen; arguments: of the command."""
    with Command(folder, "view", *arguments) as view, chromium.browser(size) as page:
        view.until_said(said)
        address = re.search(r"seen at (http://127\.0\.0\.1:\S+)", view.err)
        assert address is not None, view.err
        page.go(address[1])
        patience = time.monotonic() + TIMEOUT_S
        missing = ["all"]
        while missing and time.monotonic() < patience:
            png = page.picture()
            missing = lacking(decoded(png))
        (folder / "view.png").write_bytes(png)
        assert not missing, f"see {folder / 'view.png'}: there is no sign of {missing}"
        os.kill(view.process.pid, signal.SIGINT)
        view.end()
        assert view.process.returncode == 0, view.err
