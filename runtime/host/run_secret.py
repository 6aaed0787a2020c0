"""The secret of a run, which a session has to know to be let into it, and the key: the file in which it is.

A key has one line, ``hierax:SECRET``, which is what Zenoh calls a dictionary of users; so a Zenoh program of one's own
joins by the settings ``transport.auth.usrpwd`` with this user and password.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import errors_named

USER = "hierax"  # who Zenoh takes all those for that know the secret
_LONGEST = 1024  # bytes


def new_secret() -> str:
    """One that nobody can guess."""
    return token_hex(32)


def key_line(secret: str) -> bytes:
    """What is in a key."""
    return f"{USER}:{secret}\n".encode()


def read_key(path: Path) -> str:
    """The secret in a key. Raises `HieraxError` if it is none, or others than this user may read it."""
    with errors_named(path, "read"), path.open("rb") as file:
        mode = os.fstat(file.fileno()).st_mode & 0o777
        line = file.read(_LONGEST)
    if mode & 0o077:
        raise HieraxError(f"{path}: others may read it (mode {mode:04o}); expected a key for you alone: chmod 600")
    user, _, secret = line.decode(errors="replace").strip().partition(":")
    if user != USER or not secret.isalnum():
        raise HieraxError(f"{path}: expected the key of a run, one line '{USER}:…', as its launch has written it")
    return secret


@contextmanager
def dictionary(secret: str) -> Iterator[str]:
    """A path at which Zenoh reads the key as a session opens; it is in this process's memory alone."""
    file = os.memfd_create("hierax-key", os.MFD_CLOEXEC)
    try:
        os.write(file, key_line(secret))
        yield f"/proc/self/fd/{file}"
    finally:
        os.close(file)
