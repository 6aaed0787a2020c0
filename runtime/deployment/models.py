"""The fields of a deployment file, as pydantic models; the published JSON Schema is made from them.

They check one field at a time. What joins several (an edge's nodes, the world's name) is checked in
`hierax.runtime.deployment.read`."""

import re
from typing import Annotated, Any, Literal, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

from hierax.runtime.deployment.deployment import EPOCH_DEADLINE_S, Keys, ProcessTerms
from hierax.runtime.loading.allowance import TARGET_PATTERN, is_target
from hierax.schemas.keys import check_name
from hierax.schemas.limits import MAX_EPOCHS_APART

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"
MODULES_PATTERN = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*(\.\*)?$"
EDGE_PATTERN = r"^\s*\S+\s*->\s*\S+\s*$"

MAX_STALENESS = 8
"""Held messages bound it; more would only be a longer wait for what comes."""

MAX_CERTIFICATES_S = 3650 * 86400
"""Ten years, by far longer than a run; no calendar has the end of what holds for some thousands of years."""

LOCAL = "local"  # in the place of a host that is this machine

_MODULES = re.compile(MODULES_PATTERN)


def check_target(target: str) -> str:
    """A class or function as ``package.module:name``. Raises `ValueError` if it is written otherwise."""
    if not is_target(target):
        raise ValueError(f"expected 'package.module:name', got {target!r}")
    return target


def check_modules_pattern(pattern: str) -> str:
    """A module as ``package.module``, or a package with all that is inside it as ``package.*``; else a `ValueError`."""
    if not _MODULES.match(pattern) or pattern.endswith("\n"):
        raise ValueError(f"expected 'package.module' or 'package.*', got {pattern!r:.60}")
    if pattern == "hierax.*":
        instead = "name the packages whose nodes may join, as 'hierax.nodes.*'"
        raise ValueError(f"all of hierax is more than nodes; {instead}")
    return pattern


def split_edge(name: str) -> tuple[str, str]:
    """The lower and the upper node of ``lower -> upper``. Raises `ValueError` if it is written otherwise."""
    lower, arrow, upper = name.partition("->")
    if not arrow or not lower.strip() or not upper.strip() or "->" in upper:
        raise ValueError(f"{name!r} is no edge: expected 'lower -> upper', two names of nodes")
    return check_name(lower.strip(), "node's name"), check_name(upper.strip(), "node's name")


def _none_as_empty(kind: Any) -> BeforeValidator:
    """Let null stand for the empty list or map, or the model of one."""
    empty = list if get_origin(kind) is list else dict
    return BeforeValidator(lambda value: empty() if value is None else value, json_schema_input_type=kind | None)


def _like(pattern: str) -> WithJsonSchema:
    return WithJsonSchema({"type": "string", "pattern": pattern})


def _written_out(value: Any) -> Any:
    """The short form of a function, its name alone, in full."""
    return {"function": value} if isinstance(value, str) else value


def _host(value: Any) -> Any:
    """A host's short form in full."""
    if not isinstance(value, str):
        return {} if value is None else value
    if value != LOCAL:
        raise ValueError(f"expected {LOCAL!r}, or a map with ssh, got {value!r:.60}")
    return {}


def _where(value: Any) -> Any:
    if not isinstance(value, (str, dict)):
        raise ValueError(f"expected a host's name, or a map of labels, got {value!r:.60}")
    return value


def _zenoh(value: Any) -> Any:
    if value is not None and not isinstance(value, (str, dict)):
        raise ValueError(f"expected the path of a file, JSON5 text or a map, got {value!r:.60}")
    return value


Name = Annotated[str, AfterValidator(lambda name: check_name(name, "hierarchy's name")), _like(NAME_PATTERN)]
NodeName = Annotated[str, AfterValidator(lambda name: check_name(name, "node's name")), _like(NAME_PATTERN)]
ProcessName = Annotated[str, AfterValidator(lambda name: check_name(name, "process's name")), _like(NAME_PATTERN)]
EdgeName = Annotated[str, AfterValidator(lambda name: split_edge(name) and name), _like(EDGE_PATTERN)]
Modules = Annotated[str, AfterValidator(check_modules_pattern), _like(MODULES_PATTERN)]
Target = Annotated[str, AfterValidator(check_target), _like(TARGET_PATTERN)]
Parameters = Annotated[dict[str, Any], _none_as_empty(dict[str, Any])]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def _field(words: str, default: Any = ..., **constraints: Any) -> Any:
    """A field by what it is, which the published schema tells too; one without a default has to be given."""
    return Field(default, description=words, **constraints)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class RestartModel(_Model):
    """What is done when a node's process ends or cannot be reached; durations are in seconds."""

    restart_policy: Literal["never", "on-failure", "always"] = _field(
        "after which end of a process another one is started: none, one by a failure or signal, any",
        ProcessTerms.restart_policy,
    )
    max_restarts: int = _field("how often within restart_window; 0: no limit", ProcessTerms.max_restarts, ge=0)
    restart_delay_s: NotNegative = _field(
        "before a restart, doubled for each one within restart_window; a node's very first one is at once",
        ProcessTerms.restart_delay_s,
        alias="restart_delay",
    )
    max_restart_delay_s: NotNegative = _field(
        "the longest that restart_delay grows to", ProcessTerms.max_restart_delay_s, alias="max_restart_delay"
    )
    restart_window_s: Positive | None = _field(
        "restarts longer ago than this are forgotten; null: none ever is",
        ProcessTerms.restart_window_s,
        alias="restart_window",
    )
    rejoin_timeout_s: Positive = _field(
        "how long the epoch waits for a lost node to come back, before on_loss",
        ProcessTerms.rejoin_timeout_s,
        alias="rejoin_timeout",
    )
    on_loss: Literal["restart", "detach", "stop"] = _field(
        "a node that does not come back: wait on while it is being restarted, else stop; "
        "or detach it, and what only it joins to the world; or stop the run",
        ProcessTerms.on_loss,
    )


class SchedulingModel(_Model):
    """How the system is asked to run a node's thread; where that is not allowed, one warning says how it would be."""

    policy: Literal["fifo", "rr", "other", "idle"] = _field(
        "real-time (first in, first out; in turns), as all else, or giving way to all else", "other"
    )
    priority: int = _field("of a real-time policy", 1, ge=1, le=99)
    cpus: list[Annotated[int, Field(ge=0, le=4095)]] | None = _field(
        "the processors that the process keeps to; null: any", None
    )


class NodeModel(RestartModel):
    """A node: the class, and what it is made with. For its restarts, what is left out is as 'restart' at the top."""

    target: Target = _field(
        "module:name of a class, or of a function that is annotated to return a node", alias="class"
    )
    parameters: Parameters = _field("keyword arguments of the class", {})
    rate_hz: Positive | None = _field(
        "of the world, with the barrier: how often an epoch begins; of any node, in free running (staleness: null): "
        "how often at most it takes part in one; null: as it can",
        None,
    )
    budget_ms: Positive | None = _field(
        "how long it may be at work in an epoch: more is counted and told, nothing else; by default the world's period "
        "times the least of 'every' and its delays",
        None,
    )
    every: int = _field("it takes part in one of so many epochs", 1, ge=1, le=MAX_EPOCHS_APART)
    offset: int = _field("in which of them: in epochs n with n % every = offset", 0, ge=0)
    scheduling: SchedulingModel | None = _field("how the system is asked to run its thread, in a launch", None)


class FunctionModel(_Model):
    """A function of an edge, with parameters."""

    function: Target = _field("module:name of a function, or of a class whose objects are called")
    parameters: Parameters = _field("keyword arguments: of the class, or further ones", {})
    enabled: bool = _field("false: the empty set, always", True)


_InShort = BeforeValidator(_written_out, json_schema_input_type=Target | FunctionModel | None)
Function = Annotated[FunctionModel | None, _InShort]


class EdgeModel(_Model):
    """An edge's three functions; one that is left out gives the empty set."""

    sense: Function = _field("from the lower node's belief to the upper one's observations", None)
    task: Function = _field("from the upper node's actions to the lower one's tasks", None)
    context: Function = _field("from the upper node's belief to the lower one's context", None)
    delay: int = _field("after how many epochs context and tasks count below", 0, ge=0, le=MAX_EPOCHS_APART)
    gather: bool = _field(
        "the upper node has all observations since its last epoch, as pairs of epoch and observation", False
    )


class ProbeModel(_Model):
    """A probe of a node: sees each epoch, changes nothing."""

    node: NodeName = _field("the node that it watches")
    target: Target = _field(
        "module:name of a class, or of a function that is annotated to return a probe", alias="class"
    )
    parameters: Parameters = _field("keyword arguments of the class", {})


class HostModel(_Model):
    """A machine on which nodes run; without `ssh` it is the one that launches."""

    ssh: str | None = _field(
        "what `ssh` is told to reach it, options first: pi@robot, or -p 2222 pi@robot; null: this machine", None
    )
    python: str = _field("the command there that has hierax, such as ~/venv/bin/python", "python3", min_length=1)
    folder: str | None = _field(
        "there, where the deployment's own modules are, and processes run; null: the user's home, or with --sync the "
        "path here",
        None,
    )
    address: str | None = _field("at which the other hosts reach it; null: that at which ssh has reached it", None)
    labels: dict[str, str | bool | int | float] = _field("by which nodes are placed on it", {})
    fallback: str | None = _field("the host that has its nodes when it is lost; null: they wait until it is back", None)
    lost_after_s: Positive = _field(
        "for how many seconds nothing is heard of it until it is lost", 10.0, alias="lost_after"
    )


class ViewModel(_Model):
    """What `hierax view` shows of the deployment, beside what each node shows of itself."""

    show: Target | None = _field(
        "module:name of a function from all nodes' steps of an epoch, by name, to things by path", None
    )
    layout: list[list[str | list[str]]] | None = _field(
        "columns of views, each from top to bottom; a list of views in place of one: behind tabs", None
    )


Processes = Annotated[dict[ProcessName, list[str]], _none_as_empty(dict[ProcessName, list[str]])]
HostName = Annotated[str, AfterValidator(lambda name: check_name(name, "host's name")), _like(NAME_PATTERN)]
Hosts = Annotated[
    dict[HostName, Annotated[HostModel, BeforeValidator(_host, json_schema_input_type=Literal["local"] | HostModel)]],
    _none_as_empty(dict[HostName, Literal["local"] | HostModel]),
]
Where = Annotated[Any, AfterValidator(_where), WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]})]
Place = Annotated[dict[NodeName, Where], _none_as_empty(dict[NodeName, Where])]
Edges = Annotated[dict[EdgeName, EdgeModel], _none_as_empty(dict[EdgeName, EdgeModel])]
Probes = Annotated[list[ProbeModel], _none_as_empty(list[ProbeModel])]
ModuleList = Annotated[list[Modules], _none_as_empty(list[Modules])]
Restart = Annotated[RestartModel, _none_as_empty(RestartModel)]
Views = Annotated[ViewModel, _none_as_empty(ViewModel)]
ZenohSettings = Annotated[
    Any, AfterValidator(_zenoh), WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}, {"type": "null"}]})
]


class DeploymentModel(_Model):
    """A cognitive hierarchy: its nodes, the edges between them, and how it is run."""

    hierarchy: Name = _field("the hierarchy's name")
    description: str = _field("what it is, in one line", "")
    epochs: int | None = _field("how many; else until the world says finished", None, ge=1)
    world: NodeName = _field("which node is the external world")
    parameters: Parameters = _field("named values: ${NAME} stands for one, --set NAME=VALUE changes it", {})
    nodes: dict[NodeName, NodeModel] = _field("by name")
    edges: Edges = _field("by 'lower -> upper'", {})
    probes: Probes = _field("side outputs, no part of the run", [])
    modules: ModuleList = _field(
        "whose classes and functions may join the running hierarchy, beside what this file names: "
        "package.module, or package.* for all inside it",
        [],
    )
    restart: Restart = _field("of all nodes that say nothing else", RestartModel())
    durability: Literal["process", "host"] = _field(
        "what checkpoints outlive: the death of a process, or also that of the machine (slower)", "process"
    )
    epoch_deadline_s: Positive | None = _field(
        "how long an epoch may take before who holds it up counts as lost, in seconds; null: for ever", EPOCH_DEADLINE_S
    )
    on_uncertain_act: Literal["repeat", "skip"] = _field(
        "the world's process died, and nobody knows whether it acted: act again (at least once) or not (at most once)",
        "repeat",
    )
    staleness: int | None = _field(
        "by how many epochs inputs from above may be older than the node's own; null: free running",
        0,
        ge=0,
        le=MAX_STALENESS,
    )
    rates: bool = _field("whether nodes may have rates ('every', 'delay', …) that join while it runs", False)
    late: Literal["catch_up", "skip"] = _field(
        "of a world with a rate, what follows an epoch that took too long: those overdue begin at once, or are skipped",
        "catch_up",
    )
    start_timeout_s: Positive = _field("how long launch waits for all nodes to come up", 30.0)
    low_latency: bool = _field(
        "quicker links between processes, for messages of at most 32 KiB; a longer one ends the run", False
    )
    open: bool = _field(
        "whether anybody who reaches a launch may read and change it; by default only who has the key of the run", False
    )
    insecure: bool = _field(
        "whether what passes between machines (`--host`) may be read on the way; by default it is encrypted", False
    )
    certificates_s: Annotated[float, Field(ge=5, le=MAX_CERTIFICATES_S, allow_inf_nan=False)] | None = _field(
        "how many seconds, ten years at most, certificates of nodes' and recorders' processes hold, each of which gets "
        "a new one when a third of that is over; null: as long as the run",
        None,
    )
    processes: Processes = _field(
        "by its name, the nodes that share a process, where * stands for any letters; any other has one of its own", {}
    )
    hosts: Hosts = _field(
        "the machines on which `hierax launch` runs nodes, by name; `local`: the one that launches", {}
    )
    place: Place = _field("by node, the host that it runs on, or labels that the host has; others run here", {})
    view: Views = _field("how `hierax view` shows it; no part of the run", ViewModel())
    zenoh: ZenohSettings = _field("Zenoh's own settings: a file (relative to this one), JSON5 text, or a map", None)


class SnippetModel(_Model):
    """Nodes for a running hierarchy, and the edges that join them to it."""

    nodes: dict[NodeName, NodeModel] = _field("by name")
    edges: dict[EdgeName, EdgeModel] | None = _field("by 'lower -> upper'; one end may be a node that is running", None)


TopModel = type[DeploymentModel] | type[SnippetModel]
"""What a whole file is read as."""


def field_names(keys: Keys, top: TopModel = DeploymentModel) -> tuple[str, ...]:
    """The names of the fields that the map at a path may have; none where it is open."""
    model = _model_at(keys, top)
    if model is None:
        return ()
    return tuple(info.alias or name for name, info in model.model_fields.items())


def field_meaning(keys: Keys, top: TopModel = DeploymentModel) -> str:
    """What the field at a path is."""
    model = _model_at(keys[:-1], top)
    infos = model.model_fields.items() if model is not None else ()
    return next((info.description or "" for name, info in infos if keys[-1] in (name, info.alias)), "")


def _model_at(keys: Keys, top: TopModel) -> type[_Model] | None:
    if keys[:1] == ("nodes",) and keys[2:] == ("scheduling",):  # beside it stand parameters, which are open
        return SchedulingModel
    return _MODELS.get((keys[0], len(keys))) if keys else top


_MODELS: dict[tuple[str | int, int], type[_Model]] = {
    ("nodes", 2): NodeModel,
    ("edges", 2): EdgeModel,
    ("edges", 3): FunctionModel,
    ("probes", 2): ProbeModel,
    ("restart", 1): RestartModel,
    ("hosts", 2): HostModel,
    ("view", 1): ViewModel,
}
"""What stands at a path, by its first key and how many there are."""
