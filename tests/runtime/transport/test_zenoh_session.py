"""Sessions: settings of the user's win, and nothing is left behind."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import close_session, free_endpoint, open_session, remove_orphaned_segments


def test_it_listens_on_loopback_only() -> None:
    before = listening()
    session = open_session()
    opened = listening() - before
    close_session(session)
    assert opened
    assert all(address.startswith("0100007F:") for address in opened), opened


def listening() -> set[str]:
    """Local addresses of this process's and others' listening TCP sockets, as the kernel writes them."""
    lines = [
        line.split() for path in ("/proc/net/tcp", "/proc/net/tcp6") for line in Path(path).read_text().splitlines()
    ]
    return {fields[1] for fields in lines if fields[3] == "0A"}


@pytest.mark.parametrize("form", ["map", "text", "file"])
def test_settings_of_the_user_s_win(form: str, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    text = f'{{listen: {{endpoints: ["{endpoint}"]}}}}'
    (tmp_path / "zenoh.json5").write_text(text)
    forms = {"map": {"listen": {"endpoints": [endpoint]}}, "text": text, "file": str(tmp_path / "zenoh.json5")}
    session = open_session(settings=forms[form])
    port = f"{int(endpoint.rpartition(':')[2]):04X}"
    found = [address for address in listening() if address.endswith(f":{port}")]
    close_session(session)
    assert found


def test_the_file_that_zenoh_config_names_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint = free_endpoint()
    (tmp_path / "zenoh.json5").write_text(f'{{listen: {{endpoints: ["{endpoint}"]}}}}')
    monkeypatch.setenv("ZENOH_CONFIG", str(tmp_path / "zenoh.json5"))
    session = open_session()
    port = f"{int(endpoint.rpartition(':')[2]):04X}"
    found = [address for address in listening() if address.endswith(f":{port}")]
    close_session(session)
    assert found


@pytest.mark.parametrize("settings", ["{mode: }", '{mode: "king"}', "there/is/no/such.json5"])
def test_settings_that_zenoh_refuses_are_one_clear_error(settings: str) -> None:
    with pytest.raises(TransportError, match="Zenoh: "):
        open_session(settings=settings)


def test_orphaned_segments_are_removed_and_those_in_use_are_not() -> None:
    session = open_session()
    used = set(Path("/dev/shm").glob("*.zenoh"))
    assert used
    remove_orphaned_segments()
    assert used <= set(Path("/dev/shm").glob("*.zenoh"))
    close_session(session)
    deadline = time.monotonic() + 10
    while used & set(Path("/dev/shm").glob("*.zenoh")):
        assert time.monotonic() < deadline, "still there"
        remove_orphaned_segments()
