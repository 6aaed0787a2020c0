"""Zenoh keys: one key for each kind and direction of an edge, control keys beside them.

``hierax/{deployment}/{run}/{obs|task|ctx}/{from}/{to}``. One key has one writer, so that who may say what follows from
the names in it (`hierax.schemas.access`)."""

import re
from dataclasses import dataclass

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.limits import MAX_NAME_CHARS

STEP = "step"
"""In `Keys.seen`, in place of a message's kind: what a node has done in an epoch."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def is_name(value: object) -> bool:
    """Whether a value is a name that may stand in keys, file names and deployment files."""
    return isinstance(value, str) and len(value) <= MAX_NAME_CHARS and _NAME.fullmatch(value) is not None


def check_name(name: str, what: str = "name", where: str = "") -> str:
    """A name that may stand in keys, file names and deployment files. Raises `SchemaError` if it may not."""
    if not is_name(name):
        letters = f"at most {MAX_NAME_CHARS} letters, digits, '_', '.' or '-', beginning with a letter or a digit"
        raise SchemaError(f"{shown(name)} is no {what}: expected {letters}", where)
    return name


def check_process(token: str, what: str = "process", where: str = "") -> str:
    """A process's token: a name, or as `process_token` makes it. Raises `SchemaError` if it is none."""
    for part in token.split("~", 1) if isinstance(token, str) else [token]:
        check_name(part, what, where)
    return token


def process_token(name: str, unique: str) -> str:
    """The token of a process of a node. It begins with the node's name, and no name has a tilde: so by the key on which
    a process is told things it is known whose that is."""
    return f"{name}~{unique}"


def node_of(process: str) -> str:
    """Whose process it is, by a token as `process_token` makes it."""
    return process.partition("~")[0]


def living(key: str) -> tuple[str, str] | None:
    """The node and its process of a key on which that says that it lives; None: no process of that node does."""
    name, token = key.split("/")[-2:]
    return (name, token) if is_name(name) and node_of(token) == name and "*" not in token else None


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one run of one deployment."""

    deployment: str
    run: str

    @property
    def root(self) -> str:
        """What all keys of the run begin with."""
        return f"hierax/{self.deployment}/{self.run}"

    def edge(self, kind: str, sender: str, receiver: str) -> str:
        """The key where `sender` puts messages of `kind` for `receiver`."""
        return f"{self.root}/{kind}/{sender}/{receiver}"

    def inbox(self, receiver: str) -> str:
        """Matches every edge key that leads to `receiver`."""
        return f"{self.root}/*/*/{receiver}"

    def alive(self, name: str, instance: int | str = "*") -> str:
        """The liveliness token of an instance of a node."""
        return f"{self.root}/alive/{name}/{instance}"

    def control(self, process: str) -> str:
        """The key where a process, by its token, is told something by the roster's owner, or by its supervisor."""
        return f"{self.root}/control/{process}"

    def words(self, name: str) -> str:
        """The key where a process of a node tells the roster's owner something."""
        return f"{self.root}/words/{name}"

    @property
    def launch(self) -> str:
        """The key where the supervisor answers those who look at the launch."""
        return f"{self.root}/launch"

    @property
    def changes(self) -> str:
        """The key where the supervisor answers those who want the launch to change."""
        return f"{self.root}/changes"

    def look(self, name: str) -> str:
        """The key where a node answers those who look at it."""
        return f"{self.root}/look/{name}"

    def seen(self, kind: str, sender: str, receiver: str) -> str:
        """The key where a node shows copies of what it sends, while somebody wants to see them."""
        return f"{self.root}/seen/{kind}/{sender}/{receiver}"

    @property
    def epochs(self) -> str:
        """The key where the world publishes the digest of each committed epoch."""
        return f"{self.root}/epochs"

    def steps(self, name: str) -> str:
        """The key where a node tells whoever records what it did in each epoch."""
        return f"{self.root}/steps/{name}"

    @property
    def roster(self) -> str:
        """The key where the world tells whoever records the roster."""
        return f"{self.root}/roster"

    @property
    def notes(self) -> str:
        """The key where a supervisor tells whoever records what happens to processes."""
        return f"{self.root}/notes"

    @property
    def everything(self) -> str:
        """Matches all keys of the run, but not its liveliness tokens."""
        return f"{self.root}/**"
