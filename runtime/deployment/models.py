"""The fields of a deployment file, as pydantic models; the published JSON Schema is made from them.

They check one field at a time. What joins several (an edge's nodes, the world's name)
is checked in `hierax.runtime.deployment.read`.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

from hierax.runtime.deployment.paths import Keys
from hierax.schemas.keys import check_name

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"
TARGET_PATTERN = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*$"
EDGE_PATTERN = r"^\s*\S+\s*->\s*\S+\s*$"

_TARGET = re.compile(TARGET_PATTERN)


def check_target(target: str) -> str:
    """A class or function as ``package.module:name``.

    Raises:
        ValueError: it is written otherwise.
    """
    if not _TARGET.match(target) or target.endswith("\n"):
        raise ValueError(f"expected 'package.module:name', got {target!r}")
    return target


def split_edge(name: str) -> tuple[str, str]:
    """The lower and the upper node of ``lower -> upper``.

    Raises:
        ValueError: it is written otherwise.
    """
    lower, arrow, upper = name.partition("->")
    if not arrow or not lower.strip() or not upper.strip() or "->" in upper:
        raise ValueError(f"{name!r} is no edge: expected 'lower -> upper', two names of nodes")
    return check_name(lower.strip(), "node's name"), check_name(upper.strip(), "node's name")


def _edge(name: str) -> str:
    split_edge(name)
    return name


def _none_as_map(value: Any) -> Any:
    return {} if value is None else value


def _none_as_list(value: Any) -> Any:
    return [] if value is None else value


def _written_out(value: Any) -> Any:
    """The short form of a function, its name alone, in full."""
    return {"function": value} if isinstance(value, str) else value


def _zenoh(value: Any) -> Any:
    if value is not None and not isinstance(value, (str, dict)):
        raise ValueError(f"expected the path of a file, JSON5 text or a map, got {value!r:.60}")
    return value


Name = Annotated[
    str,
    AfterValidator(lambda name: check_name(name, "hierarchy's name")),
    WithJsonSchema({"type": "string", "pattern": NAME_PATTERN}),
]
NodeName = Annotated[
    str,
    AfterValidator(lambda name: check_name(name, "node's name")),
    WithJsonSchema({"type": "string", "pattern": NAME_PATTERN}),
]
EdgeName = Annotated[str, AfterValidator(_edge), WithJsonSchema({"type": "string", "pattern": EDGE_PATTERN})]
Target = Annotated[str, AfterValidator(check_target), WithJsonSchema({"type": "string", "pattern": TARGET_PATTERN})]
Parameters = Annotated[dict[str, Any], BeforeValidator(_none_as_map, json_schema_input_type=dict[str, Any] | None)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class NodeModel(_Model):
    """A node: the class, and what it is made with."""

    target: Target = Field(alias="class", description="module:name of a class, or of what returns a node")
    parameters: Parameters = Field(default={}, description="keyword arguments of the class")


class FunctionModel(_Model):
    """A function of an edge, with parameters."""

    function: Target = Field(description="module:name of a function, or of a class whose objects are called")
    parameters: Parameters = Field(default={}, description="keyword arguments: of the class, or further ones")
    enabled: bool = Field(default=True, description="false: the empty set, always")


Function = Annotated[
    FunctionModel | None,
    BeforeValidator(_written_out, json_schema_input_type=Target | FunctionModel | None),
]


class EdgeModel(_Model):
    """An edge's three functions; one that is left out gives the empty set."""

    sense: Function = Field(default=None, description="from the lower node's belief to the upper one's observations")
    task: Function = Field(default=None, description="from the upper node's actions to the lower one's tasks")
    context: Function = Field(default=None, description="from the upper node's belief to the lower one's context")


class ProbeModel(_Model):
    """A probe of a node: sees each epoch, changes nothing."""

    node: NodeName = Field(description="the node that it watches")
    target: Target = Field(alias="class", description="module:name of a class, or of what returns a probe")
    parameters: Parameters = Field(default={}, description="keyword arguments of the class")


class DeploymentModel(_Model):
    """A cognitive hierarchy: its nodes, the edges between them, and how it is run."""

    hierarchy: Name = Field(description="the hierarchy's name")
    description: str = Field(default="", description="what it is, in one line")
    epochs: int | None = Field(default=None, ge=1, description="how many; else until the world says finished")
    world: NodeName = Field(description="which node is the external world")
    parameters: Parameters = Field(
        default={}, description="named values: ${NAME} stands for one, --set NAME=VALUE changes it"
    )
    nodes: dict[NodeName, NodeModel] = Field(description="by name")
    edges: Annotated[
        dict[EdgeName, EdgeModel],
        BeforeValidator(_none_as_map, json_schema_input_type=dict[EdgeName, EdgeModel] | None),
    ] = Field(default={}, description="by 'lower -> upper'")
    probes: Annotated[
        list[ProbeModel], BeforeValidator(_none_as_list, json_schema_input_type=list[ProbeModel] | None)
    ] = Field(default=[], description="side outputs, no part of the run")
    start_timeout_s: float = Field(
        default=30.0, gt=0, allow_inf_nan=False, description="how long launch waits for all nodes to come up"
    )
    zenoh: Annotated[
        Any,
        AfterValidator(_zenoh),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}, {"type": "null"}]}),
    ] = Field(default=None, description="Zenoh's own settings: a file (relative to this one), JSON5 text, or a map")


def field_names(keys: Keys) -> tuple[str, ...]:
    """The names of the fields that the map at a path may have; none where it is open."""
    model = _model_at(keys)
    if model is None:
        return ()
    return tuple(info.alias or name for name, info in model.model_fields.items())


def field_meaning(keys: Keys) -> str:
    """What the field at a path is."""
    model = _model_at(keys[:-1])
    infos = model.model_fields.items() if model is not None else ()
    return next((info.description or "" for name, info in infos if keys[-1] in (name, info.alias)), "")


def _model_at(keys: Keys) -> type[_Model] | None:
    match keys:
        case ():
            return DeploymentModel
        case ("nodes", _):
            return NodeModel
        case ("edges", _):
            return EdgeModel
        case ("edges", _, _):
            return FunctionModel
        case ("probes", _):
            return ProbeModel
        case _:
            return None
