"""What a node tells whoever records: one step for each epoch that it has done.

A step is one msgpack array that any msgpack library reads, a format number in front::

    [format, name, stream, number, epoch, attempt, roster, instance, time_s, digest, state,
     sensed, start, used, passages, chain]

State, sensed belief and start are in it as bytes, each one encoded value."""

from typing import Any, NamedTuple, get_origin, get_type_hints

from hierax.schemas.checkpoint import read_fields
from hierax.schemas.errors import SchemaError
from hierax.schemas.values import PACKERS, Value, pack

FORMAT = 1


class Passage(NamedTuple):
    """A message that went in or out at a node's port."""

    sent: bool  # whether it went out
    kind: str  # of the message
    peer: str  # the other end
    epoch: int  # likewise
    attempt: int  # likewise


class NodeStep(NamedTuple):
    """An epoch of a node."""

    name: str  # of the node
    stream: str  # a token; steps of one process, told without a break, share it
    number: int  # counts the steps of a stream from 1
    epoch: int  # which one
    attempt: int  # likewise
    roster: int  # version of the roster
    instance: int  # of the node's process
    time_s: float  # the epoch's time in seconds
    digest: bytes  # the node's, of the epoch
    state: bytes  # the state after it, encoded as [belief, policy, actions]
    sensed: bytes = b""  # the belief after `observe`, encoded; empty for the world, which does not observe
    start: bytes = b""  # in the first step of a stream the state at the epoch's start, encoded; else empty
    # of inputs that may be of other epochs: (sender, kind, epoch, attempt); of what is gathered one for each epoch
    used: tuple[tuple[str, str, int, int], ...] = ()
    passages: tuple[Passage, ...] = ()  # what went in and out since the last step, some perhaps of the next
    chain: bytes = b""  # of the world's step the run's digest of the epoch, where it is known; else empty

    @property
    def when(self) -> tuple[int, int]:
        """The epoch and the attempt of it."""
        return self.epoch, self.attempt

    @property
    def used_of(self) -> dict[tuple[str, str], tuple[int, int]]:
        """The epoch and attempt of the inputs that are in `used`, by sender and kind."""
        return {(sender, kind): (epoch, attempt) for sender, kind, epoch, attempt in self.used}


_HINTS = {"format": int, **get_type_hints(NodeStep)}
_FIELDS: dict[str, type] = {name: get_origin(hint) or hint for name, hint in _HINTS.items()}
_USED = (str, str, int, int)
_PASSAGE = (bool, str, str, int, int)


def encode_step(step: NodeStep) -> bytes:
    return pack((FORMAT, *step), PACKERS)


def decode_step(data: bytes) -> NodeStep:
    """Read a step. Raises `SchemaError` if the bytes are none; says which field and what was expected."""
    step = NodeStep._make(read_fields(data, _FIELDS, "step", FORMAT)[1:])
    _check_rows(step.used, _USED, "step.used")
    _check_rows(step.passages, _PASSAGE, "step.passages")
    return step._replace(passages=tuple(Passage(*row) for row in step.passages))


def _check_rows(rows: tuple[Value, ...], types: tuple[type, ...], where: str) -> None:
    for index, row in enumerate(rows):
        given: Any = tuple(map(type, row)) if isinstance(row, tuple) else None
        if given != types:
            raise SchemaError(f"expected [{', '.join(kind.__name__ for kind in types)}]", f"{where}[{index}]")
