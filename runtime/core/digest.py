"""Digests: equal digests are the meaning of "the same run".

A node's digest of an epoch is BLAKE2b-256 over the encoding of [belief, policy, actions] and the digests of its
parents, in name order. The epoch's digest chains the last one, the epoch's number, the roster's content and N₀'s
digest, which, as the digests flow down every edge, covers all nodes."""

import struct
from collections.abc import Iterable
from hashlib import blake2b

from hierax.runtime.core.binding import Call
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.process import ActiveHierarchy, ActiveNode
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, DIGEST_BYTES, OBSERVATIONS, TASKS
from hierax.schemas.values import encode_frozen, encode_value

NO_DIGEST = bytes(DIGEST_BYTES)
"""What the first epoch's digest follows."""

EDGE_FUNCTIONS = {OBSERVATIONS: "sense", TASKS: "task", CONTEXT: "context"}
"""By kind of message, the edge function that gives it."""


def encode_state(belief: Value, policy: str, actions: Elements) -> bytes:
    """The bytes of an active node's state that digests and checkpoints are made of; its arrays are frozen."""
    return encode_frozen((belief, policy, actions))


def node_digest(state: bytes, parents: Iterable[bytes]) -> bytes:
    """The digest of a node: of its encoded state and its parents' digests, these in name order."""
    return blake2b(b"".join((state, *parents)), digest_size=DIGEST_BYTES).digest()


def epoch_digest(previous: bytes, epoch: int, roster: bytes, world: bytes) -> bytes:
    """The digest of an epoch.

    Args:
        previous: the last epoch's digest, before the first one `NO_DIGEST`.
        epoch: its number, hashed as 8 bytes, little-endian.
        roster: hash of the roster's content.
        world: N₀'s digest of this epoch.
    """
    data = b"".join((previous, struct.pack("<Q", epoch), roster, world))
    return blake2b(data, digest_size=DIGEST_BYTES).digest()


class DigestChain:
    """The digests of committed epochs, each over the last one."""

    def __init__(self, roster_hash: bytes, epoch: int = 0, digest: bytes = NO_DIGEST) -> None:
        self.roster_hash = roster_hash
        self.epoch = epoch
        self.digest = digest

    def commit(self, epoch: int, world: bytes) -> bytes:
        """The digest of the next epoch, from N₀'s digest of it."""
        self.epoch = epoch
        self.digest = epoch_digest(self.digest, epoch, self.roster_hash, world)
        return self.digest


def formal_digest(active: ActiveHierarchy, previous: bytes, roster: bytes) -> bytes:
    """The epoch's digest as the formal core has it, for comparison with the engine's."""
    hierarchy = active.hierarchy
    digests: dict[str, bytes] = {}
    for name in reversed(hierarchy.order):
        state = active.states[name]
        encoded = encode_state(state.belief, state.policy, state.actions)
        digests[name] = node_digest(encoded, (digests[upper] for upper in hierarchy.above(name)))
    return epoch_digest(previous, active.epoch, roster, digests[hierarchy.world])


def cannot_travel(name: str, epoch: int, sensed: Value, state: ActiveNode, error: SchemaError) -> OperatorError:
    """Whose fault it is that a node's state cannot be encoded; `sensed` was its belief after `observe`."""
    made = (
        ("observe", "its belief", sensed),
        (f"policy {state.policy}", "its actions", state.actions),
        ("predict", "its belief", state.belief),
    )
    for operator, what, value in made:
        flaw = _flaw(value)
        if flaw:
            return OperatorError(name, operator, epoch, f"{what}: {flaw}")
    return OperatorError(name, "predict", epoch, f"its belief and actions: {error}")  # too much together


def elements_cannot_travel(kind: str, sender: str, receiver: str, epoch: int, error: SchemaError) -> OperatorError:
    """Whose fault it is that a message cannot be encoded."""
    lower, upper = (sender, receiver) if kind == OBSERVATIONS else (receiver, sender)
    what = f"its elements for {receiver}: {error}"
    return OperatorError(f"{lower}->{upper}", EDGE_FUNCTIONS[kind], epoch, what)


def travels(call: Call, epoch: int, what: str, value: Value) -> None:
    """Whether what a call gave can travel. Raises `OperatorError` if it cannot."""
    flaw = _flaw(value)
    if flaw:
        raise OperatorError(call.subject, call.operator, epoch, f"{what}: {flaw}")


def _flaw(value: Value) -> str:
    try:
        encode_value(value)
    except SchemaError as error:
        return str(error)
    return ""
