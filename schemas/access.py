"""Who may say and hear what on a run's keys; whatever is not granted here is refused.

There are roles, which stand in certificates: the launch's own, nodes, operators, who may have the launch change, and
readers, who only look. Each node of the deployment file, and each process of several, is a role of its own. Nodes with
other names come later, when the lists of those that run can be changed no more: they have one role together, which may
say what nodes say, but nothing in the name of one that stands in the file.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from typing import NamedTuple

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import Keys, is_name, process_token
from hierax.schemas.messages import EDGE_KINDS
from hierax.schemas.values import Value

LAUNCH, OPERATOR, READER, LATER = "launch", "operator", "reader", "later node"

_CALLED = {LAUNCH: "the launch", OPERATOR: "an operator", READER: "a reader", LATER: "a later node"}
_ANY = "*"
_ANY_LAUNCH = Keys(_ANY, _ANY).launch  # what is asked by who does not know which launch it is that it has reached
_HASH_BYTES = 16  # a name of ours may be longer than one in a certificate


class Grants(NamedTuple):
    """The keys, or patterns of keys, on which a role may do things."""

    says: tuple[str, ...] = ()  # put, and delete
    hears: tuple[str, ...] = ()  # subscribe
    asks: tuple[str, ...] = ()  # ask questions, and be answered
    asked: tuple[str, ...] = ()  # be asked
    answers: tuple[str, ...] = ()  # offer answers, and give them
    lives: tuple[str, ...] = ()  # say that it lives


@dataclass(frozen=True)
class Access:
    """The nodes of a deployment file, whose processes have roles of their own."""

    world: str  # the name of the world
    processes: Mapping[str, tuple[str, ...]]  # by process, the names of its nodes

    def plain(self) -> dict[str, Value]:
        return {"world": self.world, "processes": dict(self.processes)}

    @staticmethod
    def read(value: Value) -> "Access":
        """Raises `SchemaError` if it is none."""
        processes = value.get("processes") if isinstance(value, dict) else None
        if not isinstance(processes, dict) or not is_name(value.get("world")):
            raise SchemaError(f"expected a world, and processes, got {shown(value)}", "access")
        for process, names in processes.items():
            if not is_name(process) or not isinstance(names, (tuple, list)) or not all(map(is_name, names)):
                raise SchemaError(f"expected names, got {shown(names)}", f"access.processes.{shown(process)}")
        return Access(value["world"], {process: tuple(names) for process, names in processes.items()})

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted({name for names in self.processes.values() for name in names}))

    def role_of(self, name: str, process: str = "") -> str:
        """The role of a node's process, or of the one that it shares with others."""
        together = self.processes.get(process, ())
        if name in together and len(together) > 1:
            return _role("process", process)
        return _role("node", name) if name in self.names else LATER

    def called(self) -> dict[str, str]:
        """How people call a role, by its name in certificates."""
        nodes = {_role("node", name): f"node {name}" for name in self.names}
        processes = {_role("process", name): f"process {name}" for name in self.processes}
        return {role: f"the certificate of {what}" for role, what in (nodes | processes | _CALLED).items()}

    def nodes_by_role(self) -> dict[str, tuple[str, ...]]:
        """The nodes that a role has. One that has shared a process may come back alone."""
        alone = {_role("node", name): (name,) for name in self.names}
        return alone | {_role("process", each): names for each, names in self.processes.items() if len(names) > 1}


def _role(what: str, name: str) -> str:
    return f"{what} {blake2b(name.encode(), digest_size=_HASH_BYTES).hexdigest()}"


def of_node(keys: Keys, name: str, *, is_world: bool = False) -> Grants:
    """What the process of a node may, or with ``*`` for the name of all of them."""
    says = [keys.edge(kind, name, _ANY) for kind in EDGE_KINDS]
    hears = [keys.inbox(name), keys.control(_ANY if name == _ANY else process_token(name, "$*"))]
    if is_world:
        says += [keys.control(_ANY), keys.epochs, keys.roster]
        hears += [keys.words(_ANY)]
    return Grants(
        says=(*says, keys.seen(_ANY, name, _ANY), keys.steps(name), keys.words(name)),
        hears=tuple(hears),
        asks=(keys.launch,),
        asked=(keys.look(_ANY),),
        answers=(keys.look(name),),
        lives=(keys.alive(name, _ANY if name == _ANY else process_token(name, "$*")),),
    )


def of_launch(keys: Keys) -> Grants:
    """What the launch may. It passes on what tools ask nodes, who answer them by way of it, and copies of what nodes
    say. What they say to one another it does not hear: who says that to it is no node."""
    return Grants(
        says=(keys.notes, keys.control(_ANY)),
        hears=(keys.epochs, keys.seen(_ANY, _ANY, _ANY)),
        asks=(keys.look(_ANY),),
        asked=(keys.launch, keys.changes, _ANY_LAUNCH),
        answers=(keys.launch, keys.changes, keys.look(_ANY)),
    )


def of_reader(keys: Keys) -> Grants:
    """What tools may that only look."""
    return Grants(hears=(keys.everything,), asks=(keys.look(_ANY), keys.launch, _ANY_LAUNCH))


def of_operator(keys: Keys) -> Grants:
    """What tools may that have the launch change, too."""
    reader = of_reader(keys)
    return reader._replace(asks=(*reader.asks, keys.changes))
