"""What a process writes down so that a new one can go on in its place.

Both records are one msgpack array that any msgpack library reads, a format number in front::

    [format, epoch, attempt, instance, roster, finished, start, now, under_way]
    [format, epoch, attempt, instance, roster, highest_version, last_digest, state,
     intended, acted, processes, last_attempt, trial, alone, under_way, drains]

Roster and states are in them as bytes, each one encoded value: as they are at hand
encoded, a record takes about a microsecond."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, get_type_hints

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.messages import DIGEST_BYTES, TYPE_NAMES, Message, decode_message
from hierax.schemas.roster import Roster
from hierax.schemas.values import PACKERS, Value, decode_value, encode_value, fits, is_sound, pack

FORMAT = 3

_MAX_WHOLE = (1 << 64) - 1


class Checkpoint(NamedTuple):
    """What a node but the world writes before it sends context down."""

    epoch: int  # the epoch begun last; counts from 1, 0 before the first
    attempt: int  # which attempt of it
    instance: int  # instance number of the process that writes
    roster: int  # version of the roster that the node is in
    finished: bool  # whether `now` is the state after the epoch's prediction
    start: bytes  # the state at the epoch's start, encoded as [belief, policy, actions]
    now: bytes  # the state now, likewise
    under_way: bytes = b""  # of a node with rates, as `encode_under_way` has it; empty at others


class WorldRecord(NamedTuple):
    """What the world writes before the first message of every attempt, and around an act."""

    epoch: int  # the epoch under way; counts from 1, 0 before the first
    attempt: int  # which attempt of it is begun
    instance: int  # instance number of the world's process
    roster: bytes  # the encoded value of the whole roster in force (`Roster.plain`)
    highest_version: int  # of all rosters ever prepared, dropped ones too
    last_digest: bytes  # digest of the last committed epoch
    state: bytes  # the world's state at the epoch's start, encoded as [belief, policy, actions]
    intended: int = 0  # the last epoch whose act was intended; 0 for none
    acted: int = 0  # the last epoch whose act is known to be done; 0 for none
    # The encoded map of the nodes' names to their processes: the token, the version with which the node came in, the
    # first epoch that it took part in, and the request of it; empty: unknown.
    processes: bytes = b""
    last_attempt: int = 0  # which attempt of the last epoch was committed
    # Of a node that has replaced another one with the roster in force, and whose first epoch is under way, the encoded
    # array of its name, the whole roster before it, as `processes` has them the fields of the process that it replaces,
    # and whether that node fails alone; empty: there is none.
    trial: bytes = b""
    alone: bytes = b""  # the encoded array of the names of all nodes that fail alone; empty: unknown
    under_way: bytes = b""  # as a `Checkpoint` has it
    drains: bool = False  # whether the epoch under way is a drained one, as the roster is to change after it


_CHECKPOINT: dict[str, type] = {"format": int, **get_type_hints(Checkpoint)}
_WORLD: dict[str, type] = {"format": int, **get_type_hints(WorldRecord)}
_CHECKPOINT_NAMES, _WORLD_NAMES = tuple(_CHECKPOINT), tuple(_WORLD)
_WHOLES, _PARTS = (int,) * 7, (bytes,) * 7  # of a world's record, but for `drains`


def encode_checkpoint(checkpoint: Checkpoint) -> bytes:
    """The bytes of a node's checkpoint, its states not looked into; `SchemaError` if a field or the size is wrong."""
    epoch, attempt, instance, roster, finished, start, now, under_way = checkpoint
    if not (
        type(epoch) is type(attempt) is type(instance) is type(roster) is int
        and type(finished) is bool
        and type(start) is type(now) is type(under_way) is bytes
        and 0 <= epoch <= _MAX_WHOLE
        and 0 <= attempt <= _MAX_WHOLE
        and 0 <= instance <= _MAX_WHOLE
        and 0 <= roster <= _MAX_WHOLE
    ):
        _check_fields((FORMAT, *checkpoint), _CHECKPOINT, "checkpoint")
    fields = (FORMAT, epoch, attempt, instance, roster, finished, start, now, under_way)
    return pack(fields, PACKERS, "checkpoint", _CHECKPOINT_NAMES)


def decode_checkpoint(data: bytes | memoryview) -> Checkpoint:
    """Read a node's checkpoint; its states are read to see that they are some. Raises `SchemaError` that names the
    field if the bytes are no checkpoint of this format."""
    fields = read_fields(data, _CHECKPOINT, "checkpoint")
    checkpoint = Checkpoint(*fields[1:])
    decode_state(checkpoint.start, "checkpoint.start")
    decode_state(checkpoint.now, "checkpoint.now")
    decode_under_way(checkpoint.under_way, "checkpoint.under_way")
    return checkpoint


def encode_world(record: WorldRecord) -> bytes:
    """The bytes of the world's record, its parts not looked into; `SchemaError` if a field, or the size, is wrong."""
    fields: tuple[Any, ...] = record
    epoch, attempt, instance, roster, highest, last, state, intended, acted, processes, *others = fields
    last_attempt, trial, alone, under_way, drains = others
    wholes = (epoch, attempt, instance, highest, intended, acted, last_attempt)
    parts = (roster, last, state, processes, trial, alone, under_way)
    if not (
        tuple(map(type, wholes)) == _WHOLES
        and tuple(map(type, parts)) == _PARTS
        and type(drains) is bool
        and min(wholes) >= 0
        and max(wholes) <= _MAX_WHOLE
        and acted <= intended <= epoch
        and len(last) == DIGEST_BYTES
    ):
        _check_fields((FORMAT, *record), _WORLD, "record")
        _check_world(record)
    return pack((FORMAT, *record), PACKERS, "record", _WORLD_NAMES)


def decode_world(data: bytes | memoryview) -> WorldRecord:
    """Read the world's record; its roster and state are read to see that they are such. Raises `SchemaError` that names
    the field if the bytes are no world's record of this format."""
    record = WorldRecord(*read_fields(data, _WORLD, "record")[1:])
    _check_world(record)
    version = decode_roster(record.roster, "record.roster").version
    if record.highest_version < version:
        what = f"expected at least the roster's version {version}, got {record.highest_version}"
        raise SchemaError(what, "record.highest_version")
    decode_state(record.state, "record.state")
    decode_processes(record.processes, "record.processes")
    decode_trial(record.trial, "record.trial")
    decode_alone(record.alone, "record.alone")
    decode_under_way(record.under_way, "record.under_way")
    return record


Place = tuple[str, int, int, str]
"""A process's token, the version with which its node came in, the node's first epoch, and the request of it."""


def decode_processes(data: bytes, where: str = "processes") -> dict[str, Place]:
    """The processes of a record: tokens, versions, epochs and requests by name. Raises `SchemaError` if it has none."""
    processes: dict[str, Place] = decode_value(data, where) if data else {}
    if not fits(processes, dict[str, Place]):
        raise SchemaError("expected a map of names to tokens, versions, epochs and requests", where)
    return processes


def decode_alone(data: bytes, where: str = "alone") -> tuple[str, ...] | None:
    """The nodes of a record that fail alone; None: it does not say. Raises `SchemaError` if it is no array of names."""
    names: tuple[str, ...] | None = decode_value(data, where) if data else None
    if names is not None and not fits(names, tuple[str, ...]):
        raise SchemaError("expected an array of names", where)
    return names


def encode_trial(name: str, before: Roster, place: Place, alone: bool) -> bytes:
    """The bytes of `WorldRecord.trial`."""
    return encode_value((name, before.plain(), place, alone))


def decode_trial(data: bytes, where: str = "trial") -> tuple[str, Roster, Place, bool] | None:
    """The node of a record that is tried, the roster before it, what runs there, and whether that fails alone. None:
    there is none. Raises `SchemaError` if the bytes are no such array."""
    if not data:
        return None
    trial = decode_value(data, where)
    if not fits(trial, tuple[str, dict[str, Value], Place, bool]):
        what = "a token, a version, an epoch and a request"
        raise SchemaError(f"expected a name, a roster, an array of {what}, and true or false", where)
    name, roster, place, alone = trial
    before = Roster.read(roster)
    if name not in before.nodes:
        raise SchemaError(f"{name} is no node of its roster", where)
    return name, before, place, alone


Forgotten = tuple[str, str, int, int]
"""A receiver, a kind of messages, the epoch before which it asks for none any more, and its instance that said so."""


class UnderWay(NamedTuple):
    """What a node with rates has beside its states."""

    sensed: tuple[int, Value] | None = None  # an epoch in which it has sensed and not predicted, and its belief then
    said: tuple[Message, ...] = ()  # messages that it has sent, and their receivers may lack
    forgotten: tuple[Forgotten, ...] = ()  # which of others they do not
    gathered: Mapping[str, tuple[Value, ...]] = {}


def encode_under_way(
    sensed: tuple[int, Value] | None,
    said: Sequence[bytes],
    forgotten: Sequence[Forgotten] = (),
    gathered: Mapping[str, tuple[Value, ...]] | None = None,
) -> bytes:
    """The bytes of an `UnderWay`, its messages encoded already. Raises `SchemaError` if the belief is no value."""
    fields = (() if sensed is None else sensed, tuple(said), tuple(forgotten))
    if gathered or not (sensed is None or is_sound(sensed, 1)):
        return encode_value((*fields, gathered) if gathered else fields)
    return pack(fields, PACKERS)


def decode_under_way(data: bytes, where: str = "under_way") -> UnderWay:
    """Read what `encode_under_way` gave. Raises `SchemaError` if the bytes are no such thing."""
    if not data:
        return UnderWay()
    value = decode_value(data, where)
    is_it = type(value) is tuple and fits(value[:3], tuple[Value, tuple[bytes, ...], tuple[Forgotten, ...]])
    if not is_it or type(value[0]) is not tuple or not (value[0] == () or fits(value[0], tuple[int, Value])):
        raise SchemaError("expected an array of what was sensed, of messages, and of what is forgotten", where)
    if value[3:] and not fits(value[3:], tuple[dict[str, tuple[Value, ...]]]):
        raise SchemaError("expected what was gathered, by node, behind it, or nothing", where)
    sensed, said, forgotten, *gathered = value
    return UnderWay(sensed or None, tuple(map(decode_message, said)), forgotten, *gathered)


def decode_roster(data: bytes, where: str = "roster") -> Roster:
    """The roster of a record. Raises `SchemaError` if the bytes are no encoded roster."""
    value = decode_value(data, where)
    try:
        return Roster.read(value)
    except SchemaError as error:
        raise SchemaError(error.what, where + error.where.removeprefix("roster")) from error


def decode_state(data: bytes, where: str = "state") -> tuple[Value, str, tuple[Value, ...]]:
    """Belief, policy and actions of a state. Raises `SchemaError` if the bytes are no encoded state."""
    state = decode_value(data, where)
    if type(state) is not tuple or len(state) != 3:
        raise SchemaError("expected an array of belief, policy and actions", where)
    belief, policy, actions = state
    if type(policy) is not str:
        raise SchemaError(f"expected a string, got {shown(policy)}", f"{where}.policy")
    if type(actions) is not tuple:
        raise SchemaError(f"expected an array of elements, got {shown(actions)}", f"{where}.actions")
    return belief, policy, actions


def read_fields(data: bytes | memoryview, kinds: Mapping[str, type], where: str, form: int = FORMAT) -> tuple[Any, ...]:
    """The fields of a record, a format number in front, by their types; `SchemaError` says which one is wrong."""
    fields: Any = decode_value(data, where)
    if type(fields) is not tuple or not fields:
        raise SchemaError(f"expected an array of {len(kinds)} fields", where)
    if type(fields[0]) is not int or fields[0] != form:
        raise SchemaError(f"format {shown(fields[0])}; this version reads format {form}", f"{where}.format")
    if len(fields) != len(kinds):
        raise SchemaError(f"expected an array of {len(kinds)} fields, got {len(fields)}", where)
    _check_fields(fields, kinds, where)
    return fields


def _check_fields(fields: Sequence[Any], kinds: Mapping[str, type], where: str) -> None:
    for (name, kind), field in zip(kinds.items(), fields, strict=True):
        if type(field) is not kind:
            raise SchemaError(f"expected {TYPE_NAMES[kind]}, got {shown(field)}", f"{where}.{name}")
        if type(field) is int and not 0 <= field <= _MAX_WHOLE:
            raise SchemaError(f"expected a whole number of 64 bits from 0, got {field}", f"{where}.{name}")


def _check_world(record: WorldRecord) -> None:
    if len(record.last_digest) != DIGEST_BYTES:
        what = f"expected {DIGEST_BYTES} bytes, got {len(record.last_digest)}"
        raise SchemaError(what, "record.last_digest")
    if not record.acted <= record.intended <= record.epoch:
        what = f"expected acted ≤ intended ≤ epoch, got {record.acted}, {record.intended}, {record.epoch}"
        raise SchemaError(what, "record.intended, record.acted")
