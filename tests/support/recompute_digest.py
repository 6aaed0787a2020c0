"""Recomputes a run's digests from the states that it wrote. Imports nothing of hierax.

    python recompute_digest.py DIR

DIR is the output folder of a run::

    roster.msgpack        the roster's content, one msgpack value
    states/NAME.msgpack   stream of [epoch, attempt, state (bytes), digest (32 bytes)]
    digests.msgpack       stream of [epoch, digest (32 bytes)], epochs 1, 2, ...

An epoch may be written several times, as epochs are done again where a process dies: its
last entry counts. What a killed process left half written is passed over, at a file's end
as well as with a later process's entries behind it.

A node's digest is BLAKE2b-256 over its state and the digests of the nodes above it, by
name; the epoch's digest is BLAKE2b-256 over the last epoch's (32 zeros before the
first), the epoch as 8 bytes little-endian, BLAKE2b-256 of roster.msgpack, and the
world's. Prints the last epoch's digest; exits 1 where one differs from what is written.
"""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any

import msgpack

_NUMBER = rb"(?:[\x00-\x7f]|\xcc.|\xcd.{2}|\xce.{4}|\xcf.{8})"
_HEADS = {
    b"\x92": re.compile(rb"\x92" + _NUMBER, re.DOTALL),
    b"\x94": re.compile(rb"\x94" + _NUMBER * 2 + rb"(?:\xc4(.)|\xc5(.{2})|\xc6(.{4}))", re.DOTALL),
}
"""By an entry's first byte what comes before its digest, or before its state, whose length is the group."""
_DIGEST_HEAD = b"\xc4\x20"
_DIGEST_BYTES = 32


class MismatchError(Exception):
    """What is written is not what the states give."""


def recompute(folder: Path) -> bytes:
    """The last epoch's digest.

    Raises:
        MismatchError: a written digest or epoch is not the recomputed one; says of which node and epoch.
    """
    content = (folder / "roster.msgpack").read_bytes()
    # Parameters may hold arrays; no digest looks into them, so extensions are left as they are.
    roster = msgpack.unpackb(content)
    above = parents(roster)
    states = {name: last_states(folder / "states" / f"{name}.msgpack") for name in above}
    committed: dict[int, bytes] = dict(stream(folder / "digests.msgpack"))
    digest = bytes(32)
    for epoch in range(1, max(committed, default=0) + 1):
        if epoch not in committed:
            raise MismatchError(f"digests.msgpack: no digest of epoch {epoch} is written")
        nodes = node_digests(above, states, epoch)
        digest = hashed(digest, struct.pack("<Q", epoch), hashed(content), nodes[roster["world"]])
        if digest != committed[epoch]:
            raise MismatchError(f"epoch {epoch}: the digest is {digest.hex()}, but {committed[epoch].hex()} is written")
    return digest


def hashed(*parts: bytes) -> bytes:
    """BLAKE2b-256 of the parts, one after the other."""
    return blake2b(b"".join(parts), digest_size=32).digest()


def parents(roster: Any) -> dict[str, list[str]]:
    """For each node the names above it, in order."""
    above: dict[str, list[str]] = {name: [] for name in roster["nodes"]}
    for edge in roster["edges"]:
        above[edge["lower"]].append(edge["upper"])
    return {name: sorted(uppers) for name, uppers in above.items()}


def stream(path: Path) -> Iterator[Any]:
    """The whole entries of a file, one after the other.

    Raises:
        MismatchError: the file begins with something else.
    """
    content = path.read_bytes()
    if not content:
        return
    if content[:1] not in _HEADS:
        raise MismatchError(f"{path.name}: begins with no entry")
    pattern = _HEADS[content[:1]]
    head = pattern.search(content)
    while head is not None:
        end = end_of(content, head)
        if end is None or swallows_another(content, end, pattern):
            end = head.start() + 1
        else:
            yield msgpack.unpackb(content[head.start() : end])
        head = pattern.search(content, end)


def end_of(content: bytes, head: re.Match[bytes]) -> int | None:
    """Where an entry ends that begins like this; None where it does not go on as one."""
    length = next((part for part in head.groups() if part is not None), b"")
    digest = head.end() + int.from_bytes(length, "big")
    end = digest + len(_DIGEST_HEAD) + _DIGEST_BYTES
    return end if content.startswith(_DIGEST_HEAD, digest) and end <= len(content) else None


def swallows_another(content: bytes, end: int, pattern: re.Pattern[bytes]) -> bool:
    """Whether an entry's digest is a half one, filled up from a whole entry behind it.

    Behind a whole digest the file ends, or another entry begins; within it, what looks like an entry is chance.
    """
    if end == len(content) or pattern.match(content, end):
        return False
    heads = (pattern.match(content, at) for at in range(end - _DIGEST_BYTES, end))
    return any(head is not None and end_of(content, head) is not None for head in heads)


def last_states(path: Path) -> dict[int, tuple[bytes, bytes]]:
    """By epoch, the state and the digest of its last entry."""
    return {epoch: (state, digest) for epoch, _, state, digest in stream(path)}


def node_digests(
    above: dict[str, list[str]], states: dict[str, dict[int, tuple[bytes, bytes]]], epoch: int
) -> dict[str, bytes]:
    """Every node's digest of an epoch, from the top down, each held against the written one."""
    digests: dict[str, bytes] = {}
    while len(digests) < len(above):
        ready = [name for name in above if name not in digests and all(upper in digests for upper in above[name])]
        if not ready:
            raise MismatchError("roster.msgpack: the edges form a cycle")
        for name in ready:
            if epoch not in states[name]:
                raise MismatchError(f"node {name}: no state of epoch {epoch} is written")
            state, written = states[name][epoch]
            digests[name] = hashed(state, *(digests[upper] for upper in above[name]))
            if digests[name] != written:
                raise MismatchError(
                    f"node {name}, epoch {epoch}: the digest is {digests[name].hex()}, but {written.hex()} is written"
                )
    return digests


def main(arguments: list[str]) -> int:
    """Returns the exit code."""
    if len(arguments) != 1:
        print("usage: recompute_digest.py DIR", file=sys.stderr)
        return 2
    try:
        print(recompute(Path(arguments[0])).hex())
    except MismatchError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
