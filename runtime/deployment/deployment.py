"""A deployment file: where it is looked for, its values by path as errors and ``--set`` name them, and what it says."""

import re
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.deployment.secrets import public_setting
from hierax.runtime.host.private_files import check_encodable
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.nearest import did_you_mean, nearest_of
from hierax.schemas.roster import ProbeSpec, Roster
from hierax.schemas.values import Value

Late = Literal["catch_up", "skip"]
"""What follows an epoch that took too long: those that are overdue begin at once, or their times pass by."""

Keys = tuple[str | int, ...]  # the path of a value: names and, in lists, numbers from 0

_INDEX = re.compile(r"\[(\d+)\]")
_ARROW = re.compile(r"\s*->\s*")
_PARTS = ("nodes", "edges")  # what a snippet has, too
MAX_FILE_BYTES = 1 << 22
_RECORDING = b"\x89MCAP"  # what an MCAP file begins with
_SUFFIXES = (".yaml", ".yml")
EPOCH_DEADLINE_S = 60.0
"""The default: long for a robot, and a hang is told of before its user gives up.

Operators that may take longer (a training step, a large model) need another one."""


class DeploymentError(HieraxError):
    """A deployment file, or a ``--set``, is wrong. The place is ``file:line``, the file alone, or the ``--set`` as it
    was given; the field is its path, or empty; what is wrong is told with what was expected, and the nearest valid
    name."""

    def __init__(self, what: str, place: str, field: str = "") -> None:
        self.what, self.place, self.field = what, place, field
        super().__init__(": ".join(part for part in (place, field, what) if part))


def field_text(keys: Keys) -> str:
    """A path as errors show it: ``nodes.world.parameters.noise[2]``."""
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else key
    return text


def edge_name(text: str) -> str:
    """An edge's name with one space on both sides of the arrow."""
    return _ARROW.sub(" -> ", text.strip())


def normal_path(text: str) -> str:
    """A path with ``.0`` for ``[0]`` and one way to write an edge."""
    text = _INDEX.sub(r".\1", text.strip())
    head, dot, rest = text.partition(".")
    return f"{head}{dot}{edge_name(rest)}" if head == "edges" else text


def inside(value: Any, key: str | int) -> Any:
    """What a list or map has at a key; None: nothing."""
    if isinstance(value, list) and isinstance(key, int):
        return value[key]
    return value.get(key) if isinstance(value, dict) else None


def longest_key(value: Any, rest: str) -> str | int | None:
    """The longest key of a map, or the number of a list's item, that `rest` begins with."""
    if isinstance(value, list):
        token = rest.partition(".")[0]
        return int(token) if token in map(str, range(len(value))) else None
    if not isinstance(value, dict):
        return None
    fitting = [key for key in value if rest == key or rest.startswith(f"{key}.")]
    return max(fitting, key=len, default=None)


@dataclass
class Document:
    """The values of a deployment file after ``--set``, and the places they come from."""

    place: str  # the file's name, as errors show it
    root: dict[str, Any]  # the map at the top
    lines: dict[Keys, int]  # by path, of every value in the file
    changed: dict[Keys, str] = field(default_factory=dict)  # the ``--set`` that a value comes from
    origins: dict[Keys, str] = field(default_factory=dict)  # the parameter that it was taken from
    outer: "Document | None" = None  # the document whose parameters are meant, where it is another one

    @property
    def parameters(self) -> Any:
        """The map of parameters as it was given, if it is one."""
        return (self.outer or self).root.get("parameters")

    def error(self, keys: Keys, what: str) -> DeploymentError:
        """An error about the value at a path, or the one that lacks there."""
        return DeploymentError(f"{what}{self._origin(keys)}", self.where(keys), field_text(keys))

    def where(self, keys: Keys) -> str:
        """``file:line`` of the nearest value on the path that was given, or its ``--set``."""
        changed = self._changed(keys)
        if changed is not None:
            return f"--set {public_setting(changed)}"
        line = self._line(keys)
        return f"{self.place}:{line}" if line else self.place

    def rank(self, keys: Keys) -> int:
        """The place by which errors are sorted: the line, 0 for what a ``--set`` gave."""
        return 0 if self._changed(keys) is not None else self._line(keys)

    def keys(self, text: str) -> Keys:
        """A path given as text, as far as anything is on it; names may have dots, the longest that fits is taken."""
        keys: Keys = ()
        rest = normal_path(text)
        value: Any = self.root
        while rest:
            key = longest_key(value, rest)
            if key is None:
                break
            value = value[key]
            keys, rest = (*keys, key), rest[len(str(key)) + 1 :]
        if rest and (value is None or isinstance(value, (dict, list))):  # what lacks is named, too
            keys = (*keys, rest)
        return keys

    def has_part(self, text: str) -> bool:
        """Whether the node or edge is here that a path given as text leads into."""
        kind = text.partition(".")[0]
        keys = self.keys(text)
        return kind in _PARTS and keys[:1] == (kind,) and inside(inside(self.root, kind), (*keys, "")[1]) is not None

    def _changed(self, keys: Keys) -> str | None:
        """The ``--set`` that a value comes from: what it changed has no line any more."""
        return self.changed.get(_nearest(keys, self.changed))

    def _line(self, keys: Keys) -> int:
        return self.lines.get(_nearest(keys, self.lines), 0)

    def _origin(self, keys: Keys) -> str:
        path = _nearest(keys, self.origins)
        if path not in self.origins:
            return ""
        place = (self.outer or self).where(("parameters", self.origins[path], *keys[len(path) :]))
        return f" (from ${{{self.origins[path]}}}, {place})"


def _nearest(keys: Keys, known: Container[Keys]) -> Keys:
    """The nearest path that is known of this one and those above it; else the root."""
    return next((keys[:length] for length in range(len(keys), -1, -1) if keys[:length] in known), ())


def shipped() -> dict[str, Path]:
    """The deployment files that come with hierax, by name."""
    folder = Path(str(files("hierax.deploy")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_file(name: str | Path) -> Path:
    """The deployment file of a path or a shipped name; `DeploymentError` with the nearest one if there is none."""
    path = Path(name)
    try:
        if path.is_file():
            return path
        exists = path.exists()
    except (OSError, ValueError) as error:  # a name that no file can have
        raise DeploymentError(f"cannot be read: {error}", str(name)) from error
    known = shipped()
    if str(name) in known:
        return known[str(name)]
    if exists:
        what = "is no file; expected a deployment file or the name of a shipped one"
        raise DeploymentError(what, str(name) or repr(""))
    wrong = path.stem if path.suffix in _SUFFIXES else path.name
    beside = _files_in(path.parent)
    near = nearest_of(wrong, beside)
    nearest = f"; did you mean '{beside[near]}'?" if near else did_you_mean(wrong, known, "the shipped ones are")
    raise DeploymentError(f"there is no such file, and no shipped deployment of that name{nearest}", str(name))


def _files_in(folder: Path) -> dict[str, Path]:
    """What may be deployment files in a folder, by their names without the suffix; none where it cannot be read."""
    try:
        return {each.stem: each for each in sorted(folder.iterdir()) if each.suffix in _SUFFIXES}
    except OSError:
        return {}


def read_text(path: Path) -> str:
    """A file's text. Raises `DeploymentError` if it cannot be read, is too large, or not UTF-8."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise DeploymentError(f"cannot be read: {error.strerror or error}", str(path)) from error
    if len(data) > MAX_FILE_BYTES:
        raise DeploymentError(f"has more than {MAX_FILE_BYTES} bytes; is it a deployment file?", str(path))
    if data.startswith(_RECORDING):
        what = f"is a recording; expected a deployment file. `hierax replay {path}` does again what is in it"
        raise DeploymentError(what, str(path))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        what = f"byte {data[error.start]:#04x} is not UTF-8; save the file as UTF-8"
        raise DeploymentError(what, f"{path}:{line}") from error


def import_paths(path: Path) -> tuple[str, ...]:
    """The folders in which a deployment's own modules are looked for: the file's, and the current one. Raises
    `HieraxError` if one of them is not UTF-8, as processes are told of them."""
    for place in (path, path.resolve(), Path.cwd()):
        check_encodable(place)
    return tuple(dict.fromkeys((str(path.resolve().parent), str(Path.cwd()))))


@dataclass(frozen=True)
class ProcessTerms:
    """How a node's process is kept, which changes nothing of what the node computes from its inputs.

    When it ends or cannot be reached, its supervisor restarts it by the first five; the roster's owner waits for it by
    the next two. The defaults start a process that was killed again at once, as far as anybody can see, and give up on
    one that falls over again and again within some seconds."""

    restart_policy: Literal["never", "on-failure", "always"] = "on-failure"  # after which end of a process
    max_restarts: int = 5  # how many within the window; the next end of the process is its last. 0: no limit.
    restart_delay_s: float = 0.1  # until a restart, doubled for each one within the window; the very first is at once
    max_restart_delay_s: float = 5.0  # what it is doubled up to
    restart_window_s: float | None = 60.0  # restarts before so many seconds count no more; None: all count
    rejoin_timeout_s: float = 10.0  # how long the epoch is held for a lost node, back-off included
    # What follows then. ``restart``: it is waited for as long as its supervisor may restart it, then the run is
    # stopped; ``detach``: it is detached, and what only it joins to the world; ``stop``: the run is stopped.
    on_loss: Literal["restart", "detach", "stop"] = "restart"
    rate_hz: float | None = None  # how often at most it takes part in an epoch; None: as it can
    budget_ms: float | None = None  # how long it may be at work in an epoch; None: by its rates and the world's period
    scheduling: Mapping[str, Value] | None = None  # how the system is asked to run its thread

    @property
    def fails_alone(self) -> bool:
        """Whether the node is detached, and nothing else ends, when an operator or edge function of it raises."""
        return self.on_loss == "detach" and self.restart_policy != "always"


@dataclass(frozen=True)
class Host:
    """A machine on which nodes run."""

    name: str  # by which the deployment file calls it
    ssh: tuple[str, ...] = ()  # what `ssh` is told to reach it: options, and the destination; empty: this machine
    python: str = "python3"  # the command there that has hierax; `~` is the user's home there
    folder: str = ""  # there, where the deployment's own modules are, and processes run; empty: the user's home
    address: str = ""  # at which the other hosts reach it; empty: that at which ssh has reached it
    labels: Mapping[str, Value] = field(default_factory=dict)  # by which nodes are placed on it
    fallback: str = ""  # the host that has its nodes' next processes when it is lost; empty: they wait for it
    lost_after_s: float = 10.0  # how long nothing is heard of it until it is lost

    @property
    def is_here(self) -> bool:
        return not self.ssh


@dataclass(frozen=True)
class ViewSpec:
    """How a viewer shows a deployment; no part of the run."""

    show: str | None = None  # ``module:name`` of a function of all nodes' steps of an epoch, or None
    # columns of cells from top to bottom, each with the names of views that share it; None: by what nodes show
    layout: tuple[tuple[tuple[str, ...], ...], ...] | None = None


@dataclass(frozen=True)
class Deployment:
    """What a deployment file says, after ``--set``."""

    path: Path  # the file
    name: str  # of the hierarchy
    description: str  # in one line; may be empty
    epochs: int | None  # how many by default; None: until the world says finished
    roster: Roster  # nodes and edges
    probes: tuple[ProbeSpec, ...]  # in the file's order; where errors name one, it is ``probes[i]``
    modules: tuple[str, ...]  # from which code may be loaded, now and later; those that the file names are among them
    terms: Mapping[str, ProcessTerms]  # by node, of all nodes
    restart: ProcessTerms  # of nodes that are attached later and say nothing else
    durability: Literal["process", "host"]  # whose death checkpoints outlive
    epoch_deadline_s: float | None  # how long until who holds an epoch up counts as lost, in seconds; None: for ever
    on_uncertain_act: Literal["repeat", "skip"]  # of a world of which nobody knows if it acted: at least, at most once
    staleness: Staleness  # how old inputs from above may be
    late: Late  # what follows an epoch of a world with a rate that took too long
    start_timeout_s: float  # how long all nodes may take to come up, in seconds
    zenoh: Mapping[str, Value] | str | None  # its own settings: a map, JSON5 text in braces, or the path of a file
    low_latency: bool  # whether processes have links that carry short messages more quickly, and no long ones
    open: bool  # whether anybody who reaches a launch may speak to it
    insecure: bool  # whether links between machines are not encrypted
    certificates_s: float | None  # how long certificates of nodes' processes hold, in seconds; None: as the run does
    import_paths: tuple[str, ...]  # folders in which the deployment's own modules are looked for
    document: Document = field(repr=False, compare=False)  # where everything stands in the file
    view: ViewSpec = ViewSpec()  # how a viewer shows it
    processes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # by name, the nodes that share one
    hosts: Mapping[str, Host] = field(default_factory=dict)  # the machines on which a launch may run nodes, by name
    placed: Mapping[str, str] = field(default_factory=dict)  # by node, the host on which it runs; others run here
    snippets: tuple[Document, ...] = field(default=(), repr=False, compare=False)  # that change it as it runs

    @property
    def allowance(self) -> Allowance:
        """Which code may be loaded."""
        return Allowance(self.modules)

    @property
    def overlaps(self) -> bool:
        """Whether nodes may be in different epochs."""
        return self.roster.rates is not None or not self.staleness.barrier

    def place(self, where: str) -> str:
        """``file:line`` of a path such as ``nodes.world.class``, or the ``--set`` that gave it."""
        return self.document.where(self.document.keys(where))

    @contextmanager
    def explaining(self) -> Iterator[None]:
        """Raise errors with their place in the file, as `explain` gives them, in place of those without."""
        try:
            yield
        except HieraxError as error:
            explained = self.explain(error)
            if explained is error:
                raise
            raise explained from error

    def explain(self, error: HieraxError) -> HieraxError:
        """An error with its place in the file, if its `where`, as `LoadError` has it, is a path in the roster; or in
        `snippets`, if it is one there. What is in several of them has all these places."""
        where = getattr(error, "where", "")
        documents = [each for each in (self.document, *self.snippets) if each.has_part(where)]
        if where.partition(".")[0] not in _PARTS:
            documents = [self.document]
        if not where or not documents:
            return error
        found = [each.error(each.keys(where), str(error).removeprefix(f"{where}: ")) for each in documents]
        return DeploymentError(
            found[-1].what, " or ".join(dict.fromkeys(each.place for each in found)), found[-1].field
        )
