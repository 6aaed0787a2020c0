"""What a roster's owner, the nodes' processes and their supervisors say to one another.

Each is a msgpack array of its name and its fields. A *process* is a token that no two
processes share; a node's name stays the same when its process is another one."""

from collections.abc import Callable
from typing import NamedTuple, cast, get_args, get_type_hints

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import check_name, check_process
from hierax.schemas.limits import MAX_NEIGHBOURS, MAX_NUMBER, MAX_STATE_BYTES, MAX_TEXT_CHARS, MAX_WORD_BYTES
from hierax.schemas.values import Value, decode_value, encode_value, fits

NEVER = -1  # the epoch of a process that has no checkpoint


class Prepare(NamedTuple):
    """Owner to process: get ready for a version of the roster (as `Roster.plain` gives it), and say so."""

    roster: dict[str, Value]
    alone: tuple[str, ...] = ()  # the nodes in it that fail alone: what they raise is told, and ends no process
    tried: tuple[str, ...] = ()  # likewise, in the first epoch: what they replace waits until its commit


class Unchanged(NamedTuple):
    """Owner to process: a version has its node, its neighbours and their edges as an earlier one has them."""

    version: int
    earlier: int


class HandOver(NamedTuple):
    """Owner to the process that is replaced: say the state after the attempt of an epoch that counts."""

    version: int
    epoch: int
    attempt: int


class TakeOver(NamedTuple):
    """Owner to the process that replaces another: here is its state after the attempt of the epoch that counts."""

    version: int
    epoch: int
    attempt: int
    state: bytes
    under_way: bytes = b""  # with rates, what goes with it, as a checkpoint has it


class AskStatus(NamedTuple):
    """Owner to process: say what you wait for."""

    inquiry: int


class Resend(NamedTuple):
    """Owner to process: send what these neighbours were sent in this attempt once more."""

    epoch: int
    attempt: int
    receivers: tuple[str, ...]


class CatchUp(NamedTuple):
    """Owner to process: with rates, the run's last epoch is committed; say so when you have done all up to it."""

    epoch: int


class Dismiss(NamedTuple):
    """Owner to process: it is not in the hierarchy, and why; `again`: lost, a new one may come, from its checkpoint."""

    why: str
    again: bool = False


class Join(NamedTuple):
    """Process to owner: it is there to run a node."""

    name: str
    process: str
    request: str  # the change that it was started for; empty: it comes in the place of a lost one
    epoch: int  # the last epoch that it has begun, or finished by its checkpoint; `NEVER` without one
    active: bool  # whether it has taken part in an epoch; then it asks whether it still may
    refusal: str  # why it cannot run the node after all; mostly empty
    version: int = 0  # of the roster under which its checkpoint was written; of one that is active, in which it is
    attempt: int = 0  # of that epoch


class Ready(NamedTuple):
    """Process to owner: all links of a version are open; or why they can't be."""

    name: str
    process: str
    version: int
    refusal: str


class State(NamedTuple):
    """Process to owner: the answer to `HandOver`."""

    name: str
    version: int
    state: bytes
    under_way: bytes = b""  # as `TakeOver` has it


class Taken(NamedTuple):
    """Process to owner: the state is taken over; or why it can't be."""

    name: str
    version: int
    refusal: str


class Fetch(NamedTuple):
    """Process to owner: send this version of the roster."""

    name: str
    process: str
    version: int


class Status(NamedTuple):
    """Process to owner: the answer to `AskStatus`."""

    name: str
    inquiry: int
    epoch: int
    attempt: int
    waits_for: tuple[tuple[str, str], ...]  # names of senders and kinds of messages
    busy: str  # the operator that the process is in; empty: in none
    version: int = 0  # of the roster that the node is in


class CaughtUp(NamedTuple):
    """Process to owner: the answer to `CatchUp`."""

    name: str
    process: str
    epoch: int


class Failed(NamedTuple):
    """Process to owner: an operator or edge function of a node that fails alone has raised, and why, in one line."""

    name: str  # who says so; an edge function may run in the process of the other node
    process: str  # likewise
    version: int  # of the roster under which it happened
    subject: str  # the node, or the edge as ``lower->upper``
    why: str


class Lost(NamedTuple):
    """Supervisor to owner: a process has died; whether another one will come in its place."""

    name: str
    process: str
    restarts: bool


class Census(NamedTuple):
    """Supervisor to the world's process, or to an owner that is new: the processes that it keeps, which are up."""

    processes: dict[str, str]


class Propose(NamedTuple):
    """To the owner: a change of the roster (as its `plain` gives it) is asked for."""

    request: str
    change: dict[str, Value]
    on_loss: dict[str, str] = {}  # noqa: RUF012 - never changed; by node that is new in it, as `OwnerPolicy` has it
    rejoin_timeout_s: dict[str, float] = {}  # noqa: RUF012 - likewise
    alone: tuple[str, ...] = ()  # those of them that fail alone


Offered = Prepare | Unchanged | HandOver | TakeOver | AskStatus | Resend | CatchUp
"""What a process is told by the owner on its own key; a dismissal comes by way of its supervisor."""

Order = Offered | Dismiss  # what a process is told by the owner

Word = Join | Ready | State | Taken | Fetch | Status | Failed | CaughtUp
"""What a process says to the owner on the owner's key; the rest comes by way of the supervisor."""

Control = Order | Word | Lost | Census | Propose  # every kind of control message

_KINDS: dict[str, Callable[..., object]] = {kind.__name__: kind for kind in get_args(Control)}
_FIELDS = {kind.__name__: get_type_hints(kind) for kind in get_args(Control)}
_LONG = (Prepare, TakeOver, State, Propose, Census)  # the kinds that hold a roster, a state or a list of processes

_LONG_HEADS = tuple(
    bytes([0x91 + len(kind._fields), 0xA0 + len(kind.__name__)]) + kind.__name__.encode() for kind in _LONG
)
_NAMES = frozenset({"name", "process", "request"})
_TEXTS = frozenset({"why", "refusal", "busy"})
_MAY_BE_EMPTY = frozenset({"request", "process"})


def encode_control(control: Control) -> bytes:
    """The bytes of a control message, its texts cut where they are too long; `SchemaError` if it is too long itself."""
    fields = (_cut(part) if field in _TEXTS else part for field, part in zip(control._fields, control, strict=True))
    data = encode_value((type(control).__name__, *fields))
    _check_length(data)
    return data


def decode_control(data: bytes) -> Control:
    """Read a control message. Raises `SchemaError` if it is none; says which field and what was expected."""
    _check_length(data)
    value = decode_value(data, "control")
    name = value[0] if isinstance(value, tuple) and value else None
    kind = _KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise SchemaError(f"expected an array that begins with one of {', '.join(_KINDS)}", "control")
    fields = _FIELDS[name]
    if len(value) != len(fields) + 1:
        raise SchemaError(f"expected {len(fields)} fields, got {len(value) - 1}", f"control.{name}")
    for (field, hint), part in zip(fields.items(), value[1:], strict=True):
        if not fits(part, hint):
            raise SchemaError(f"got {shown(part)}", f"control.{name}.{field}")
        _check_content(field, part, f"control.{name}.{field}")
    return cast(Control, kind(*value[1:]))


def _check_length(data: bytes) -> None:
    """Before it is decoded: only what may hold a roster or a state may be long."""
    most = MAX_STATE_BYTES if data.startswith(_LONG_HEADS) else MAX_WORD_BYTES
    if len(data) > most:
        raise SchemaError(f"{len(data)} bytes; at most {most} are allowed", "control")


def _check_content(field: str, part: Value, where: str) -> None:
    """What the types don't say: names that may stand in keys, whole numbers within bounds, short texts and lists."""
    if type(part) is int and not NEVER <= part <= MAX_NUMBER:
        raise SchemaError(f"{part} is out of bounds", where)
    if field in _TEXTS and len(part) > MAX_TEXT_CHARS:
        raise SchemaError(f"{len(part)} characters; at most {MAX_TEXT_CHARS} are allowed", where)
    if field in _NAMES and not (field in _MAY_BE_EMPTY and not part):
        (check_process if field == "process" else check_name)(part, where=where)
    if field in ("receivers", "waits_for"):
        if len(part) > MAX_NEIGHBOURS:
            raise SchemaError(f"{len(part)} entries; at most {MAX_NEIGHBOURS} are allowed", where)
        for each in part:
            check_name(each if field == "receivers" else each[0], where=where)


def _cut(text: Value) -> Value:
    return text if len(text) <= MAX_TEXT_CHARS else text[: MAX_TEXT_CHARS - 1] + "…"
