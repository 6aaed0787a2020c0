"""What a supervisor and its children say to each other, over the child's standard input and output.

Each frame is 4 bytes of length (little-endian) and an encoded value. The child's first
frame in is its order (`NodeOrder`), the next ones are commands; end of file means that the
supervisor is gone. What a child says is a map with ``"status"``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.roster import ProbeSpec, Reference, Roster
from hierax.schemas.values import Value, decode_value, encode_value

_LENGTH = struct.Struct("<I")

STOP = "stop"
"""Command: finish, report, exit."""

UP = "up"
"""Status: every neighbour hears this node and is heard."""
FINISHED = "finished"
"""Status of the world: the last epoch is committed."""
REPORT = "report"
"""Status: the node's final state; the last one before its process exits."""
FAILED = "failed"
"""Status: the node cannot go on."""


@dataclass(frozen=True)
class NodeOrder:
    """All that a node's process has to know.

    Attributes:
        name: of the node.
        deployment, run: what the keys begin with.
        roster: who else there is.
        seed: of the run.
        epochs: how many; None: until the world has finished.
        hub: endpoint of the supervisor, through which the processes find one another.
        settings: Zenoh's own.
        output: folder for states and probes; empty: none.
        probes: of this node.
        import_paths: where modules of the deployment's own are looked for.
    """

    name: str
    deployment: str
    run: str
    roster: Roster
    seed: int
    epochs: int | None
    hub: str
    settings: Value
    output: str
    probes: tuple[ProbeSpec, ...]
    import_paths: tuple[str, ...]

    @property
    def output_path(self) -> Path | None:
        """The output folder."""
        return Path(self.output) if self.output else None

    def plain(self) -> Value:
        """As a value."""
        return {
            **self.__dict__,
            "roster": self.roster.plain(),
            "probes": [[probe.node, probe.reference.plain()] for probe in self.probes],
        }

    @staticmethod
    def read(value: Value) -> NodeOrder:
        """From a value; it comes from our own supervisor, so only the roster is checked in full."""
        probes = tuple(ProbeSpec(node, Reference.read(ref, f"probes.{node}")) for node, ref in value["probes"])
        return NodeOrder(**{**value, "roster": Roster.read(value["roster"]), "probes": probes})


def frame(value: Value) -> bytes:
    """A value as a frame."""
    data = encode_value(value)
    return _LENGTH.pack(len(data)) + data


class Frames:
    """Takes frames out of bytes as they come."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Value]:
        """The values whose last byte is here now.

        Raises:
            SchemaError: what came are no frames.
        """
        self._buffer += data
        values = []
        while len(self._buffer) >= _LENGTH.size:
            length = _LENGTH.unpack_from(self._buffer)[0]
            if length > MAX_MESSAGE_BYTES:
                raise SchemaError(f"a frame of {length} bytes; at most {MAX_MESSAGE_BYTES} are allowed", "pipe")
            end = _LENGTH.size + length
            if len(self._buffer) < end:
                break
            values.append(decode_value(bytes(self._buffer[_LENGTH.size : end]), "pipe"))
            del self._buffer[:end]
        return values
