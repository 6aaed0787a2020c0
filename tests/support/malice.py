"""What attacks by files have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hierax.schemas.roster import Reference
from hierax.schemas.values import decode_value, encode_value
from support.junk_recordings import Contents

MARKER = "hierax_test_marker"
PRECIOUS = "precious.json"  # the name of a file that is to stay as it is, and what is in it
NOT_OURS = "nothing shows that this user has written it"

NESTED = b"\x91" * 100_000 + b"\xc0"
CLAIMS = {
    "deep nesting": NESTED,
    "an array of 2^32 - 1": b"\xdd" + b"\xff" * 4,
    "a map of 2^32 - 1": b"\xdf" + b"\xff" * 4,
    "bytes of 2^32 - 1": b"\xc6" + b"\xff" * 4 + b"x",
    "a foreign extension": b"\xc7\x04\x7fabcd",
    "an object's extension": b"\xc7\x10\x01" + bytes(16),
    "a million empty maps": b"\xdd\x00\x10\x00\x00" + b"\x80" * (1 << 20),
}
"""Values that claim, or are, too much; by what they are."""


class Place(NamedTuple):
    """Where an attack is made."""

    folder: Path  # its own; nothing but what it makes is in it
    deployment: Path  # a right file
    recording: Contents  # of that, by this user

    @property
    def theirs(self) -> Path:
        """A folder with a module that tells that it was imported."""
        folder = self.folder / "theirs"
        folder.mkdir(exist_ok=True)
        text = f"from pathlib import Path\nPath({str(self.folder / 'ran')!r}).touch()\n"
        (folder / f"{MARKER}.py").write_text(text + "from support.toy_nodes import *\n", encoding="utf-8")
        return folder

    @property
    def touches(self) -> Reference:
        """Code that tells that it was called."""
        return Reference("os:system", {"command": f"touch {self.folder / 'ran'}"})

    def file(self, name: str, content: str | bytes, mode: int = 0o600) -> Path:
        path = self.folder / name
        path.parent.mkdir(mode=0o700, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        path.chmod(mode)
        return path


class Attack(NamedTuple):
    """One way to try it."""

    made: Callable[[Place], Sequence[str]]  # makes the files; gives hierax's arguments
    says: str  # what stands in the line with which it is refused
    codes: tuple[int, ...] = (1,)  # with which the command ends


def names_code(place: Place, data: bytes) -> bytes:
    """A roster with a node that is code which tells that it was called."""
    roster: Any = decode_value(data)
    return encode_value({**roster, "nodes": {**roster["nodes"], "left": place.touches.plain()}})
