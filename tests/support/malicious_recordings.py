"""Recordings made to run code, to fill the memory, or to reach other files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import lz4.frame
import zstandard

from hierax.runtime.recording.writing import INFO, MAGIC
from support.junk_recordings import Contents, Said
from support.malice import CLAIMS, MARKER, NOT_OURS, Attack, Place, names_code


def _recorded(change: Callable[[Place, Contents], Contents], *command: str) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        path = place.folder / "crafted.mcap"
        change(place, place.recording).write(path)
        first, *options = command or ("replay", "--verify")
        return (first, str(path), *options)

    return made


def _said(topic: str, data: Callable[[Place, bytes], bytes]) -> Callable[[Place, Contents], Contents]:
    """A recording in which everything of some topics is something else."""

    def change(place: Place, contents: Contents) -> Contents:
        def other(each: Said) -> Said:
            return each._replace(data=data(place, each.data)) if f"/{topic}" in each.topic else each

        return replace(contents, said=tuple(map(other, contents.said)))

    return change


def _told(**fields: Any) -> Callable[[Place, Contents], Contents]:
    """A recording that says other things of its run; a function of the place is called."""

    def change(place: Place, contents: Contents) -> Contents:
        given = {name: value(place) if callable(value) else value for name, value in fields.items()}
        info = {**contents.metadata[INFO], **given}
        return replace(contents, metadata={**contents.metadata, INFO: info})

    return change


def _carries(claim: bytes) -> Callable[[Place, bytes], bytes]:
    """A message whose payload is something else: the last field of twelve."""
    return lambda place, data: b"\x9c\x01\x00\xa5world\xa4left\x01\x00\x00\x00\xcb" + bytes(8) + b"\xc4\x00\x80" + claim


def _chunk(compression: str, zeros: int, size: int) -> Callable[[Place], Sequence[str]]:
    """A recording that ends with a chunk of so many zeros, which says that it has another size."""

    def made(place: Place) -> Sequence[str]:
        data = _compressed(compression, zeros)
        path = place.folder / "crafted.mcap"
        place.recording.write(path)
        head = b"".join(_records_before_chunks(path.read_bytes()))
        body = (
            (0).to_bytes(8, "little") * 2
            + size.to_bytes(8, "little")
            + bytes(4)
            + len(compression).to_bytes(4, "little")
            + compression.encode()
            + len(data).to_bytes(8, "little")
            + data
        )
        path.write_bytes(head + bytes([6]) + len(body).to_bytes(8, "little") + body)
        return ("replay", str(path), "--verify")

    return made


def _records_before_chunks(data: bytes) -> Sequence[bytes]:
    """What is in a recording before its first chunk, record by record."""
    at, found = len(MAGIC), [MAGIC]
    while data[at] != 6:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        found.append(data[at:end])
        at = end
    return found


def _compressed(name: str, zeros: int) -> bytes:
    """That many zeros."""
    if name not in ("zstd", "lz4"):
        return bytes(zeros)
    if name == "zstd":
        packer = zstandard.ZstdCompressor().compressobj(size=zeros)
        head = b""
    else:
        packer = lz4.frame.LZ4FrameCompressor()
        head = packer.begin(zeros)
    return head + b"".join(packer.compress(bytes(1 << 20)) for _ in range(zeros >> 20)) + packer.flush()


def _length(length: int) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        path = place.folder / "crafted.mcap"
        place.recording.write(path)
        head = b"".join(_records_before_chunks(path.read_bytes()))
        path.write_bytes(head + bytes([6]) + length.to_bytes(8, "little") + bytes(64))
        return ("replay", str(path), "--verify")

    return made


def _inspected(change: Callable[[Place, Contents], Contents]) -> Callable[[Place], Sequence[str]]:
    return lambda place: ("inspect", "left", _recorded(change)(place)[1])


_MODULES = {"modules": json.dumps([MARKER, "os"]), "import_paths": lambda place: json.dumps([str(place.theirs)])}
RECORDINGS = {
    "replay, whose modules are theirs": Attack(_recorded(_told(**_MODULES)), NOT_OURS),
    "view, whose modules are theirs": Attack(_recorded(_told(**_MODULES), "view", "--save", "seen.rrd"), NOT_OURS),
    "inspect, whose modules are theirs": Attack(_inspected(_told(**_MODULES)), NOT_OURS),
    "diff, whose modules are theirs": Attack(
        lambda place: (*_recorded(_told(**_MODULES), "diff")(place), str(place.deployment)), "", (0,)
    ),
    "whose rosters call os.system": Attack(_recorded(_said("roster", names_code)), "may not be loaded"),
    "of a run called ../../precious": Attack(_recorded(_told(run="../../precious")), "run"),
    "that says it in nested JSON": Attack(_recorded(_told(machine="[" * 100_000)), "metadata"),
    "that claims a record of 2^62 bytes": Attack(_length(1 << 62), ""),
    "that claims a record of 2^29 bytes": Attack(_length(1 << 29), "", (0, 1)),
    "zip bomb of 1 GiB (zstd)": Attack(_chunk("zstd", 1 << 30, 1 << 30), ""),
    "zip bomb of 1 GiB (zstd) that claims 1 KiB": Attack(_chunk("zstd", 1 << 30, 1 << 10), ""),
    "zip bomb of 1 GiB (lz4)": Attack(_chunk("lz4", 1 << 30, 1 << 30), ""),
    "compressed as nobody does": Attack(_chunk("../../evil", 1, 1), ""),
    **{f"messages with {what}": Attack(_recorded(_said("obs", _carries(each))), "") for what, each in CLAIMS.items()},
    **{f"steps of {what}": Attack(_recorded(_said("steps", lambda _, __, each=each: each)), "")
       for what, each in CLAIMS.items()},
    **{f"rosters of {what}": Attack(_recorded(_said("roster", lambda _, __, each=each: each)), "")
       for what, each in CLAIMS.items()},
}  # fmt: skip
