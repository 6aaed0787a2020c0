"""What one user's runs have written can be told from what somebody else has, or has changed."""

from __future__ import annotations

import os
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from hierax.runtime.host.run_folder import (
    KEY_BYTES,
    RECORDING,
    STATE,
    NoKeyError,
    _warn,
    is_sealed,
    key_file,
    seal,
    seal_or_warn,
)

CONTENT: dict[str, Any] = {
    "deployment": "/a.yaml",
    "modules": ("a", "b.*"),
    "machine": {"n": 2, "load": 0.1},
    "n": None,
}


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    _warn.cache_clear()
    return tmp_path


def test_what_is_sealed_is_known_again_and_nothing_else() -> None:
    given = seal(RECORDING, CONTENT)
    assert is_sealed(RECORDING, {**CONTENT, "modules": ["a", "b.*"]}, given)
    for other in ({"modules": ("a", "*")}, {"n": 0}, {"more": 1}):
        assert not is_sealed(RECORDING, {**CONTENT, **other}, given)
    assert not is_sealed(STATE, CONTENT, given)
    for text in ("", "0" * 64, given[:-1], given.upper(), "ä", given + "\n"):
        assert not is_sealed(RECORDING, CONTENT, text)


def test_the_key_is_the_users_alone() -> None:
    seal(STATE, CONTENT)
    found = key_file().stat()
    assert (stat.S_IMODE(found.st_mode), found.st_size, found.st_uid) == (0o600, KEY_BYTES, os.getuid())
    assert [path.name for path in key_file().parent.iterdir()] == ["key"]


def test_nobody_elses_key_fits(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = seal(RECORDING, CONTENT)
    monkeypatch.setenv("XDG_STATE_HOME", str(home / "other"))
    assert not is_sealed(RECORDING, CONTENT, given)
    assert not key_file().exists()  # to look makes none


def test_runs_that_begin_at_once_have_one_key() -> None:
    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(lambda _: seal(STATE, CONTENT), range(32)))) == 1


def test_a_key_that_is_a_link_or_torn_is_none(home: Path) -> None:
    key_file().parent.mkdir(parents=True, mode=0o700)
    (home / "known").write_bytes(bytes(KEY_BYTES))
    key_file().symlink_to(home / "known")
    with pytest.raises(NoKeyError, match="symbolic link"):
        seal(STATE, CONTENT)
    key_file().unlink()
    key_file().write_bytes(bytes(KEY_BYTES - 1))
    key_file().chmod(0o600)
    with pytest.raises(NoKeyError, match="expected 32 bytes that nobody else can read; remove it"):
        seal(STATE, CONTENT)


def test_without_a_key_nothing_is_sealed_and_that_is_told_once(home: Path, caplog: pytest.LogCaptureFixture) -> None:
    (home / "state").write_text("no folder")
    assert seal_or_warn(STATE, CONTENT) == seal_or_warn(STATE, CONTENT) == ""
    assert [record.message.partition(": ")[0] for record in caplog.records] == [
        "what this run leaves will not be known to be yours, and take --trust"
    ]


def test_a_folder_that_others_write_to_keeps_no_key(home: Path) -> None:
    key_file().parent.mkdir(parents=True)
    key_file().parent.chmod(0o777)
    with pytest.raises(NoKeyError, match="others may write there"):
        seal(STATE, CONTENT)
