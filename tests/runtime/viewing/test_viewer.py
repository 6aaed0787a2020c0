from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path
from urllib.parse import parse_qs, urlparse
from urllib.request import urlopen

import pytest
from support.launched import is_alive, processes_of, until

pytest.importorskip("rerun", reason="the extra [view] is not installed")

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.viewing import viewer
from hierax.runtime.viewing.viewer import Place, file, stream_of, web_viewer, window


def listening(port: int) -> set[str]:
    """The local addresses, hexadecimal, of sockets that listen on a port."""
    lines = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()]
    return {
        line[1].partition(":")[0] for line in lines if line[3] == "0A" and int(line[1].partition(":")[2], 16) == port
    }


def test_the_page_is_served_on_loopback_alone_and_ends_with_the_block() -> None:
    others = set(processes_of(os.getpid()))  # of earlier tests: multiprocessing has a helper that stays
    with web_viewer(stream_of("test"), None, "64MiB", False) as page:
        parts = urlparse(page.name)
        data = urlparse(parse_qs(parts.query)["url"][0].removeprefix("rerun+"))
        assert parts.port is not None
        assert data.port is not None
        for port in (parts.port, data.port):
            assert listening(port) == {"0100007F"}  # 127.0.0.1
        with urlopen(f"http://{parts.netloc}/", timeout=20) as answer:
            assert b"<html" in answer.read().lower()
        servers = set(processes_of(os.getpid())) - others
    assert servers
    assert not any(is_alive(pid) for pid in servers)
    assert not listening(parts.port)


def test_the_server_ends_with_the_process_that_started_it() -> None:
    code = (
        "from hierax.runtime.viewing.viewer import *\n"
        "import os, signal\n"
        "with web_viewer(stream_of('test'), None, '64MiB', False):\n"
        "    print(open(f'/proc/{os.getpid()}/task/{os.getpid()}/children').read(), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    servers = [int(pid) for pid in done.stdout.split()]
    assert servers, done.stderr
    until(lambda: not any(is_alive(pid) for pid in servers), "the server is gone")


def test_a_port_that_is_taken_is_told_and_none_is_found_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with (
            pytest.raises(HieraxError, match=rf"^--port {port}: another process listens there$"),
            web_viewer(stream_of("test"), port, "64MiB", False),
        ):
            pass
        monkeypatch.setattr(viewer, "WEB_PORT", port)
        with web_viewer(stream_of("test"), None, "64MiB", False) as page:
            assert urlparse(page.name).port != port


def test_a_server_that_does_not_start_is_told() -> None:
    with (
        pytest.raises(HieraxError, match=r"^Rerun's viewer does not listen on port [0-9]+: .*memory"),
        web_viewer(stream_of("test"), None, "a lot", False),
    ):
        pass


def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "there").write_text("no folder")
    with (
        pytest.raises(HieraxError, match=r"there/x\.rrd: cannot be written: "),
        file(stream_of("test"), tmp_path / "there" / "x.rrd"),
    ):
        pass


def test_what_is_there_stays_until_a_file_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    path.write_bytes(b"RRF of before")
    with pytest.raises(HieraxError), file(stream_of("test"), path, overwrite=True):
        raise HieraxError
    assert path.read_bytes() == b"RRF of before"
    with file(stream_of("test"), path, overwrite=True):
        pass
    assert path.read_bytes() != b"RRF of before"
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_no_regular_file_is_not_replaced() -> None:
    with (
        pytest.raises(HieraxError, match="/dev/null: cannot be written: it is no regular file"),
        file(stream_of("test"), Path("/dev/null"), overwrite=True),
    ):
        pass


def wait_for(place: Place) -> None:
    assert place.until_closed is not None
    place.until_closed()


def test_a_window_that_does_not_open_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(HieraxError, match=r"^Rerun's viewer .*DISPLAY"), window(stream_of("test"), "64MiB") as place:
        wait_for(place)
