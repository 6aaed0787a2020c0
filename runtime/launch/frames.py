"""What a supervisor and its children say to each other, over the child's standard input and output.

Each frame is 4 bytes of length (little-endian) and an encoded value. The child's first
frame in is the orders of its nodes (`NodeOrder`), mostly of one; the next ones are commands, each a
node's token and what it is told; end of file means that the supervisor is gone. What a child says is a
map with ``"status"``, and ``"from"``: the token of the node that says it.
"""

import os
import struct
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from secrets import token_hex

from hierax.runtime.deployment.deployment import Late
from hierax.runtime.execution.world_member import OnUncertainAct, Supervision
from hierax.runtime.host.run_secret import end_of, issued
from hierax.runtime.launch.pipes import read_some
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.owner.owner import Owner
from hierax.runtime.recovery.disk import Durability
from hierax.runtime.transport.zenoh_session import OWN_ADDRESS
from hierax.schemas.access import Access
from hierax.schemas.control import Dismiss
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import process_token
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.roster import ProbeSpec, Reference, Roster
from hierax.schemas.values import Value, decode_value, encode_value

_LENGTH = struct.Struct("<I")

STOP = "stop"  # command, a map: do all up to the run's last epoch, report, exit
ROSTER = "roster"  # beside it: the last one, for who came back to a run that was over
# What is no command is a control message for the roster's owner, as bytes.
FINISH = "finish"  # command to the world: the epoch under way is the last one
LEAVE = "leave"  # command, a map: report the last epoch committed (None: the world knows it) at once, and exit

UP = "up"  # status: every neighbour hears this node and is heard
FINISHED = "finished"  # status of the world: the last epoch is committed; the roster, and its processes
REPORT = "report"  # status: the node's final state; the last one before its process exits
FAILED = "failed"  # status: the node cannot go on
DISMISSED = "dismissed"  # status: the owner has told the process to exit, and why; the last one
CUT_OFF = "cut off"
"""Status: the process was taken for lost, and exits so that another one comes in its place; the last one."""
ANSWER = "answer"  # status of the world: what became of a change that somebody asked for
END = "end"  # status of the world: a process hangs, and is to be killed
DISMISS = "dismiss"  # status of the world: a process has no place any more, and is to be told so
HALT = "halt"  # status of the world: the run cannot go on, and why
ENDED = "ended"  # status of a node that has come to its end in a process in which others go on; its exit code
BEAT = "beat"  # status of the world, again and again and when its roster changes: the epoch, and the roster's processes
MISSES = "misses"  # status: the link to a process broke, and it has not come back
NOTE = "note"  # status of the world: people should know

RENEW = "renew"  # command, a map: go on with another certificate, which is in this secret
RENEWED = "renewed"  # status: the process has done so

KEEP = "keep"  # status of a process on another host: a record for its checkpoint, which the supervisor has
KEPT = "kept"  # command, a map: all records up to this number are where they outlive the process
LOG = "log"  # status of such a process: a line for its log
APPEND = "append"  # status of such a process: an entry for `STATES` or `DIGESTS` in the output folder
STATES, DIGESTS = "states", "digests"

BEGIN, COME_BACK, NEWCOMER, TO_REPORT = "begin", "come back", "newcomer", "to report"
"""How a process comes into a run: with it, in the place of a lost one, for a change of the roster, or after its end."""


def new_process(name: str) -> str:
    """The token of a new process of a node."""
    return process_token(name, token_hex(8))


@dataclass(frozen=True, kw_only=True)
class NodeOrder:
    """All that a node's process has to know."""

    name: str  # of the node
    process: str  # the process's token; nodes that share one have a token each
    shares: str = ""  # the name of the process that it shares with others; empty: it has one of its own
    life: str  # `BEGIN`, `COME_BACK`, `NEWCOMER` or `TO_REPORT`
    request: str = ""  # of a newcomer, the change that it is started for
    deployment: str  # what the keys begin with
    run: str  # likewise
    roster: Roster | None = None  # of a process that begins with the run, who else there is
    modules: tuple[str, ...]  # from which code may be loaded, as `hierax.runtime.loading.allowance.Allowance` has them
    preload: tuple[str, ...]  # those that are imported before anything else
    seed: int  # of the run
    epochs: int | None  # how many; None: until the world has finished
    staleness: int | None  # how old inputs from above may be, in epochs; None: free running
    rate_hz: float | None = None  # in free running, how often at most the node takes part in an epoch; None: as it can
    late: Late = "catch_up"  # of the world's, which has a rate with the barrier, too
    budget_ms: float | None = None  # how long the node may be at work in an epoch; None: by its rates and the period
    period_ms: float | None = None  # from an epoch to the next; None: there is no rate
    rated: bool = False  # whether nodes may take part in some epochs only
    scheduling: Mapping[str, Value] | None = None  # how the system is asked to run the node's thread
    hub: str  # endpoint of the supervisor, through which the processes find one another
    door: str = ""  # path of the socket where the run's other processes link to this one; empty: it has none
    doors: tuple[str, ...] = ()  # those that it links to
    host: str  # address of the process's machine at which others may link; empty: this machine's processes only
    secret: str = field(default="", repr=False)  # of the run, or as `admitted` gives it; empty: it is open
    lifetime_s: float | None = None  # how long its certificate holds; None: as long as the run
    access: Access | None = (
        None  # who has roles of their own in the run; None: links are not encrypted, and all may all
    )
    settings: Value  # Zenoh's own
    low_latency: bool  # whether the processes' links are low-latency ones
    output: str = ""  # folder for states and probes; empty: none
    probes: tuple[ProbeSpec, ...] = ()  # of this node
    import_paths: tuple[str, ...]  # where modules of the deployment's own are looked for
    checkpoint: str  # path of the node's checkpoint, without the slot's ending
    durability: Durability  # of the checkpoint
    owner: OwnerPolicy | None = None  # of the world's process: what the deployment says on recovery
    on_uncertain_act: OnUncertainAct = "repeat"  # of the world's process
    processes: Mapping[str, str] = field(default_factory=dict)  # of the world's: those of other nodes that live
    alone: tuple[str, ...] = ()  # the nodes of `roster` that fail alone
    recorded: bool = False  # whether somebody records the run, who has to hear the process from its first message on
    slots: tuple[bytes, ...] | None = None
    """Of a process on another host than the supervisor, which keeps its checkpoint: what that holds."""

    states: bool = False  # whether such a process tells its states and digests, for the supervisor's output folder
    elsewhere: bool = False  # whether who attaches the node starts the process: its dismissal comes over Zenoh

    @property
    def allowance(self) -> Allowance:
        return Allowance(self.modules)

    @property
    def output_path(self) -> Path | None:
        return Path(self.output) if self.output else None

    def admitted(self) -> "NodeOrder":
        """The order as its process gets it: with a certificate for the node's role alone, and its machine's address."""
        if self.access is None:
            return self
        role = self.access.role_of(self.name, self.shares)
        secret = issued(self.secret, role, [self.host or OWN_ADDRESS], end_of(self.lifetime_s))
        return replace(self, secret=secret)

    def plain(self) -> Value:
        return {
            **self.__dict__,
            "access": None if self.access is None else self.access.plain(),
            "roster": None if self.roster is None else self.roster.plain(),
            "probes": [[probe.node, probe.reference.plain(), probe.overwrite] for probe in self.probes],
            "owner": None if self.owner is None else self.owner.__dict__,
        }

    @staticmethod
    def read(value: Value) -> "NodeOrder":
        """Read an order from a value; it comes from our own supervisor, so only the roster is checked in full."""
        probes = tuple(
            ProbeSpec(node, Reference.read(ref, f"probes.{node}"), may) for node, ref, may in value["probes"]
        )
        roster = None if value["roster"] is None else Roster.read(value["roster"])
        owner = None if value["owner"] is None else OwnerPolicy(**value["owner"])
        slots = None if value["slots"] is None else tuple(value["slots"])
        access = None if value["access"] is None else Access.read(value["access"])
        read = {"access": access, "roster": roster, "probes": probes, "owner": owner, "slots": slots}
        return NodeOrder(**{**value, **read})


def frame(value: Value) -> bytes:
    data = encode_value(value)
    return _LENGTH.pack(len(data)) + data


class Frames:
    """Takes frames out of bytes as they come."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Value]:
        """The values whose last byte is here now. Raises `SchemaError` if what came are no frames."""
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


async def next_frames(descriptor: int, frames: Frames) -> list[Value]:
    """At least one frame of what comes of a pipe; none when its other end is gone."""
    while data := await read_some(descriptor):
        if values := frames.feed(data):
            return values
    return []


class SupervisorPipe(Supervision):
    """The process's end of the pipe; and, in the world's process, how the roster's owner reaches the supervisor."""

    def __init__(
        self, status: int, on_gone: Callable[[], None], token: str = "", saying: "threading.Lock | None" = None
    ) -> None:
        self._status = status  # file descriptor on which the supervisor listens
        self._on_gone = on_gone  # called when it does not listen any more
        self._token = token  # of the node that says it
        self._saying = saying or threading.Lock()  # of all nodes of the process
        self._beating = threading.Lock()
        self._finished = False

    def say(self, status: str, **fields: Value) -> None:
        """Say something, if somebody is still there; any thread may call it."""
        data = memoryview(frame({"status": status, "from": self._token, **fields}))
        try:
            with self._saying:
                while data:
                    data = data[os.write(self._status, data) :]
        except BrokenPipeError:
            self._on_gone()

    def end(self, name: str, process: str, why: str) -> None:
        self.say(END, name=name, process=process, why=why)

    def stop(self, why: str) -> None:
        self.say(HALT, why=why)

    def note(self, what: str) -> None:
        self.say(NOTE, what=what)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        self.say(ANSWER, request=request, epoch=epoch, refusal=refusal)

    def dismiss(self, process: str, word: Dismiss) -> None:
        """A process is no part of the hierarchy any more: its supervisor, or this one for it, is to tell it."""
        self.say(DISMISS, process=process, why=word.why, again=word.again)

    def beat(self, owner: Owner) -> None:
        """The world's process lives; and the roster."""
        with self._beating:  # two threads do: what is said last is to be what holds
            roster = owner.members.roster
            self.say(
                BEAT,
                epoch=owner.progress.epoch,
                version=roster.version,
                instances={name: roster.instance(name) for name in roster.nodes},
                processes=dict(owner.members.processes),
            )

    def finish(self, owner: Owner) -> None:
        if not self._finished:
            self._finished = True
            members = owner.members
            roster, processes = members.roster.plain(), dict(members.processes)
            self.say(FINISHED, epoch=owner.progress.epoch, processes=processes, roster=roster)
