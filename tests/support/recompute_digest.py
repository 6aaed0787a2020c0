"""Recomputes a run's digests from the states that it wrote. Imports nothing of hierax.

    python recompute_digest.py DIR

DIR is the output folder of a run::

    roster.msgpack        the roster's content, one msgpack value
    states/NAME.msgpack   stream of [epoch, attempt, state (bytes), digest (32 bytes)]
    digests.msgpack       stream of [epoch, digest (32 bytes)], epochs 1, 2, ...

A node's digest is BLAKE2b-256 over its state and the digests of the nodes above it, by
name; the epoch's digest is BLAKE2b-256 over the last epoch's (32 zeros before the
first), the epoch as 8 bytes little-endian, BLAKE2b-256 of roster.msgpack, and the
world's. Prints the last epoch's digest; exits 1 where one differs from what is written.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any

import msgpack

MAX_STREAM_BYTES = 1 << 31


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
    states = {name: last_attempts(folder / "states" / f"{name}.msgpack") for name in above}
    digest = bytes(32)
    for epoch, (number, written) in enumerate(stream(folder / "digests.msgpack"), start=1):
        if number != epoch:
            raise MismatchError(f"digests.msgpack: expected epoch {epoch}, found {number}")
        nodes = node_digests(above, states, epoch)
        digest = hashed(digest, struct.pack("<Q", epoch), hashed(content), nodes[roster["world"]])
        if digest != written:
            raise MismatchError(f"epoch {epoch}: the digest is {digest.hex()}, but {written.hex()} is written")
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
    """The values of a file, one after the other."""
    with path.open("rb") as file:
        yield from msgpack.Unpacker(file, max_buffer_size=MAX_STREAM_BYTES)


def last_attempts(path: Path) -> dict[int, tuple[bytes, bytes]]:
    """By epoch, the state and the digest of its last attempt."""
    found: dict[int, tuple[int, bytes, bytes]] = {}
    for epoch, attempt, state, digest in stream(path):
        if epoch not in found or attempt >= found[epoch][0]:
            found[epoch] = (attempt, state, digest)
    return {epoch: (state, digest) for epoch, (_, state, digest) in found.items()}


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
