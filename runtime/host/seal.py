"""Seals: what a user's own runs have written can be told from what somebody else has, or has changed.

A key of 32 random bytes is kept for each user on each machine, beside the logs. What runs say of themselves is sealed
with it (keyed BLAKE2b) when it is written; only who has the key could have made a seal that fits."""

from __future__ import annotations

import functools
import hmac
import json
import logging
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path
from secrets import token_bytes
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import UnsafeFileError, read_private, write_private
from hierax.runtime.host.run_folder import runs_folder

RECORDING, STATE = "recording", "state"  # what is sealed: no seal of one fits the other
KEY_BYTES = 32
SEAL_BYTES = 32

NOT_OURS = (
    "it names code to run, and nothing shows that this user has written it on this machine and nobody has changed it; "
    "--trust loads and runs what it names"
)
"""Why something is refused that has no seal of ours."""

_log = logging.getLogger("hierax")


class NoKeyError(HieraxError):
    """No key can be kept or read; says where, and why."""


def key_file() -> Path:
    """Where the user's key is."""
    return runs_folder().parent / "key"


def seal(what: str, content: Mapping[str, Any]) -> str:
    """The seal of a `RECORDING` or `STATE` with this content, as JSON. Raises `NoKeyError` if no key can be kept."""
    return _sealed(what, content, _key(make=True))


def seal_or_warn(what: str, content: Mapping[str, Any]) -> str:
    """Seal as `seal` does; empty where nothing can be sealed, which is told once."""
    try:
        return seal(what, content)
    except NoKeyError as error:
        _warn(f"what this run leaves will not be known to be yours, and take --trust: {error}")
        return ""


@functools.cache
def _warn(text: str) -> None:
    _log.warning("%s", text)


def is_sealed(what: str, content: Mapping[str, Any], given: str) -> bool:
    """Whether this user wrote a `RECORDING` or `STATE` here, unchanged since; its content is without the given seal."""
    if not given:
        return False
    try:
        wanted = _sealed(what, content, _key(make=False))
    except (NoKeyError, TypeError, ValueError):  # no key, or what nobody could have sealed
        return False
    return hmac.compare_digest(wanted.encode(), given.encode(errors="replace"))


def _sealed(what: str, content: Mapping[str, Any], key: bytes) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return blake2b(text.encode(), key=key, digest_size=SEAL_BYTES, person=what.encode()).hexdigest()


def _key(make: bool) -> bytes:
    """The user's key. Raises `NoKeyError` if there is none, or it is not this user's alone."""
    path = key_file()
    try:
        if make and not path.exists():  # where another process makes one at the same time, it is that one
            write_private(path, token_bytes(KEY_BYTES), replaces=False)
        key = read_private(path)
    except UnsafeFileError as error:
        raise NoKeyError(str(error)) from error
    except OSError as error:
        raise NoKeyError(f"{path}: {error.strerror or error}") from error
    if len(key) != KEY_BYTES:
        what = f"expected {KEY_BYTES} bytes that nobody else can read; remove it to have another made"
        raise NoKeyError(f"{path}: {what}")
    return key
