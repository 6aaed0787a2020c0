"""The secret of a run, which a session has to know to be let into it, and the key: the file in which it is.

A key begins with a line ``hierax:TOKEN``, which is what Zenoh calls a dictionary of users; so a Zenoh program of one's
own joins by the settings ``transport.auth.usrpwd`` with this user and password. Where other machines may join, the
run's authority follows (`hierax.runtime.host.run_certificates`). In memory, a secret is the same text without the user.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import errors_named

USER = "hierax"  # who Zenoh takes all those for that know the secret
_LONGEST = 4096  # bytes
_AUTHORITY = re.compile(
    r"-----BEGIN CERTIFICATE-----\n[\w+/=\n]+-----END CERTIFICATE-----\n-----BEGIN PRIVATE KEY-----\n"
    r"[\w+/=\n]+-----END PRIVATE KEY-----\n",
    re.ASCII,
)


def new_secret(authority: bool = False) -> str:
    """One that nobody can guess; authority: whether links are to be encrypted, too."""
    token = token_hex(32)
    if not authority:
        return token
    from hierax.runtime.host.run_certificates import new_authority  # few runs need it, and it takes a while

    return f"{token}\n{new_authority()}"


def token_of(secret: str) -> str:
    """What Zenoh takes for a password."""
    return secret.partition("\n")[0]


def authority_of(secret: str) -> str:
    """What certificates of the run's sessions are made by; empty: they need none, as links are not encrypted."""
    return secret.partition("\n")[2]


def key_text(secret: str) -> bytes:
    """What is in a key."""
    text = f"{USER}:{secret}"
    return (text if text.endswith("\n") else f"{text}\n").encode()


def read_key(path: Path) -> str:
    """The secret in a key. Raises `HieraxError` if it is none, or others than this user may read it."""
    with errors_named(path, "read"), path.open("rb") as file:
        mode = os.fstat(file.fileno()).st_mode & 0o777
        text = file.read(_LONGEST + 1).decode(errors="replace")
    if mode & 0o077:
        raise HieraxError(f"{path}: others may read it (mode {mode:04o}); expected a key for you alone: chmod 600")
    line, _, authority = text.partition("\n")
    user, _, token = line.strip().partition(":")
    is_whole = user == USER and token.isalnum() and len(text) <= _LONGEST
    if not is_whole or (authority.strip() and not _AUTHORITY.fullmatch(authority)):
        raise HieraxError(f"{path}: expected the key of a run, a line '{USER}:…', as its launch has written it")
    return f"{token}\n{authority}" if authority.strip() else token


@contextmanager
def dictionary(secret: str) -> Iterator[str]:
    """A path at which Zenoh reads the key as a session opens; it is in this process's memory alone."""
    file = os.memfd_create("hierax-key", os.MFD_CLOEXEC)
    try:
        os.write(file, key_text(token_of(secret)))
        yield f"/proc/self/fd/{file}"
    finally:
        os.close(file)
