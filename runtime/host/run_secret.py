"""The secret of a run, which a session has to know to be let into it, and the key: the file in which it is.

A key begins with a line ``hierax:TOKEN``, which is what Zenoh calls a dictionary of users; so a Zenoh program of one's
own joins by the settings ``transport.auth.usrpwd`` with this user and password. Where other machines may join,
certificates follow (`hierax.runtime.host.run_certificates`): the run's authority with its private key, by which
certificates of all roles are made; or, in the key of one role, the authority's certificate, and one of that role with
its private key. In memory, a secret is the same text without the user.
"""

import os
import re
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta, timezone
from pathlib import Path
from secrets import token_hex

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import errors_named

USER = "hierax"  # who Zenoh takes all those for that know the secret
_LONGEST = 4096  # bytes
_CERTIFICATE = "-----BEGIN CERTIFICATE-----\n"
_PEM = rf"(?:{_CERTIFICATE}[\w+/=\n]+-----END CERTIFICATE-----\n){{1,2}}"
_PRIVATE_KEY = "-----BEGIN PRIVATE KEY-----\n"
_CERTIFICATES = re.compile(rf"{_PEM}{_PRIVATE_KEY}[\w+/=\n]+-----END PRIVATE KEY-----\n", re.ASCII)


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


def certificates_of(secret: str) -> str:
    """The certificates, and the private key of the last one; empty: there are none, as links are not encrypted."""
    return secret.partition("\n")[2]


def pems_of(secret: str) -> tuple[str, str, str]:
    """Of a secret of one role: the authority's certificate, the role's, and the private key of that. Raises
    `HieraxError` if it has none."""
    if not is_secret(secret) or may_issue(secret):
        raise HieraxError("the key of the run holds no certificate and private key that can be read")
    _, root, rest = certificates_of(secret).split(_CERTIFICATE)
    shown, begins, private = rest.partition(_PRIVATE_KEY)
    return f"{_CERTIFICATE}{root}", f"{_CERTIFICATE}{shown}", f"{begins}{private}"


def may_issue(secret: str) -> bool:
    """Whether certificates of other roles can be made by it, as it has the private key of the run's authority."""
    return secret.count(_CERTIFICATE) == 1


def issued(secret: str, role: str, addresses: Sequence[str] = (), until: datetime | None = None) -> str:
    """The secret that is for one role, as certificates name it, which listens at some addresses, until a time.

    One that is a role's already stays as it is, as does one without certificates. Raises `HieraxError` if it cannot be
    read."""
    if not may_issue(secret):
        return secret
    from hierax.runtime.host.run_certificates import certificates

    return f"{token_of(secret)}\n{certificates(certificates_of(secret), role, addresses, until)}"


def end_of(lifetime_s: float | None) -> datetime | None:
    """When a certificate ends that is made now and holds for so long; None: for ever. Raises `HieraxError` if that
    is after all calendars."""
    if lifetime_s is None:
        return None
    try:
        return datetime.now(timezone.utc) + timedelta(seconds=lifetime_s)
    except OverflowError as error:
        expected = "expected an end before the year 10000"
        raise HieraxError(f"a certificate cannot hold for {lifetime_s:g} s; {expected}") from error


def whose(secret: str) -> tuple[str, datetime] | None:
    """The role that a secret is for, and until when; None: it is the run's own, for all. Raises `HieraxError` if it
    cannot be read."""
    if not certificates_of(secret) or may_issue(secret):
        return None
    from hierax.runtime.host.run_certificates import role_of

    return role_of(certificates_of(secret))


def key_text(secret: str) -> bytes:
    """What is in a key."""
    text = f"{USER}:{secret}"
    return (text if text.endswith("\n") else f"{text}\n").encode()


def read_key(path: Path) -> str:
    """The secret in a key. Raises `HieraxError` if it is none, or others than this user may read it."""
    with errors_named(path, "read"), open(path, "rb", opener=_opened_at_once) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise HieraxError(f"{path}: is no file; expected the key of a run")
        mode, text = found.st_mode & 0o777, file.read(_LONGEST + 1).decode(errors="replace")
    if mode & 0o077:
        raise HieraxError(f"{path}: others may read it (mode {mode:04o}); expected a key for you alone: chmod 600")
    line, _, certificates = text.partition("\n")
    user, _, token = line.strip().partition(":")
    secret = f"{token}\n{certificates}" if certificates.strip() else token
    if user != USER or len(text) > _LONGEST or not is_secret(secret):
        raise HieraxError(f"{path}: expected the key of a run, a line '{USER}:…', as its launch has written it")
    return secret


def _opened_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)  # what is no file might be waited for


def is_secret(value: object) -> bool:
    """Whether a value has the form of a secret."""
    if not isinstance(value, str) or len(value) > _LONGEST or not token_of(value).isalnum():
        return False
    certificates = certificates_of(value)
    return not certificates or _CERTIFICATES.fullmatch(certificates) is not None


@contextmanager
def dictionary(secret: str) -> Iterator[str]:
    """A path at which Zenoh reads the key as a session opens; it is in this process's memory alone."""
    file = os.memfd_create("hierax-key", os.MFD_CLOEXEC)
    try:
        os.write(file, key_text(token_of(secret)))
        yield f"/proc/self/fd/{file}"
    finally:
        os.close(file)
