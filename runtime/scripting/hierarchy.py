"""A hierarchy described in Python, in the place of a deployment file."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.node import World
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import Document
from hierax.runtime.deployment.read import deployment_of
from hierax.runtime.deployment.written import yaml_of
from hierax.runtime.loading.loader import makes
from hierax.runtime.scripting.names import Code, named, script_folders, script_modules
from hierax.schemas.roster import FUNCTIONS

_BY_PARTIAL = "by `functools.partial` alone, as some are"
_GIVEN = {
    "hierarchy": "as the name",
    "world": "by `add`, as the node whose class derives from World",
    "nodes": "by `add`",
    "edges": "by `join`",
    "probes": "by `probe`",
}
"""Fields at the top of a file that are given in another way here."""


class Hierarchy:
    """Nodes by class, edges by function: what a deployment file says, from Python.

    >>> hierarchy = Hierarchy("servo", epochs=60)
    >>> hierarchy.add("world", SlidingWorld).add("camera", CameraNode)
    >>> hierarchy.join("world", "camera", sense=partial(MeasuredPosition, noise=0.1), task=camera_task)

    Classes and functions are given as themselves, with parameters as `functools.partial` of them. They have to be at
    the top of a module: processes of a launch import them from there. The node whose class derives from `World` is N₀.

    Args:
        name: of the hierarchy.
        fields: what else stands at the top of a deployment file: ``epochs``, ``staleness``, ``modules``, ….
    """

    def __init__(self, name: str, **fields: Any) -> None:
        _check_fields(fields, _GIVEN, f"hierarchy {name!r}")
        self.name = name
        self._fields = _plain(fields)
        self._world: str | None = None
        self._nodes: dict[str, dict[str, Any]] = {}
        self._edges: dict[str, dict[str, Any]] = {}
        self._probes: list[dict[str, Any]] = []

    def add(self, name: str, of: Code, **fields: Any) -> "Hierarchy":
        """A node. Raises `HierarchyError` if there is one of that name, or `of` cannot be found by its name.

        Args:
            name: of the node.
            of: its class, or a function annotated to return a node.
            fields: what else a deployment file says of a node: ``on_loss``, ``rate_hz``, ``every``, ….
        """
        if name in self._nodes:
            raise HierarchyError(f"there is a node {name!r} already")
        target, parameters = named(of, f"node {name!r}")
        if _makes_world(of):
            if self._world is not None:
                raise HierarchyError(f"node {name!r} is a World, and {self._world!r} is one already; expected one")
            self._world = name
        otherwise = {"class": "in its own place", **({"parameters": _BY_PARTIAL} if parameters else {})}
        _check_fields(fields, otherwise, f"node {name!r}")
        self._nodes[name] = {"class": target, **({"parameters": parameters} if parameters else {}), **_plain(fields)}
        return self

    def join(
        self,
        lower: str,
        upper: str,
        *,
        sense: Code | None = None,
        task: Code | None = None,
        context: Code | None = None,
        **fields: Any,
    ) -> "Hierarchy":
        """An edge, with φ, ψ and ϱ; one that is None gives the empty set. Raises `HierarchyError` as `add` does.

        Args:
            lower, upper: names of the nodes.
            sense, task, context: the functions.
            fields: what else a deployment file says of an edge: ``delay``, ``gather``.
        """
        edge = f"{lower} -> {upper}"
        if edge in self._edges:
            raise HierarchyError(f"there is an edge {edge!r} already")
        functions = {
            kind: _function(given, f"edge {edge!r}, {kind}")
            for kind, given in zip(FUNCTIONS, (sense, task, context), strict=True)
            if given is not None
        }
        self._edges[edge] = {**functions, **_plain(fields)}
        return self

    def probe(self, node: str, of: Code) -> "Hierarchy":
        """A probe of a node. Raises `HierarchyError` if `of` cannot be found by its name."""
        target, parameters = named(of, f"probe of {node!r}")
        self._probes.append({"node": node, "class": target, **({"parameters": parameters} if parameters else {})})
        return self

    def snippet(self, deployment: Deployment) -> Document:
        """Its nodes and edges, for a run of a deployment. Raises `HierarchyError` if it says more than these."""
        more = [*self._fields, *(["probes"] if self._probes else [])]
        if more:
            raise HierarchyError(f"hierarchy {self.name!r}: what joins a run has nodes and edges alone, no {more[0]}")
        edges = {"edges": self._edges} if self._edges else {}
        root = {"nodes": self._nodes, **edges}
        return Document(f"hierarchy {self.name!r}", root, {}, outer=deployment.document)

    def targets(self) -> list[str]:
        """All that it names, as ``module:name``."""
        functions = [edge[kind] for edge in self._edges.values() for kind in FUNCTIONS if kind in edge]
        named_so = [each if isinstance(each, str) else each["function"] for each in functions]
        return [each["class"] for each in (*self._nodes.values(), *self._probes)] + named_so

    def root(self) -> dict[str, Any]:
        """All that it says, as a deployment file does. Raises `HierarchyError` if it has no world."""
        if self._world is None:
            raise HierarchyError(f"hierarchy {self.name!r} has no world: add a node whose class derives from World")
        probes = {"probes": self._probes} if self._probes else {}
        top = {"hierarchy": self.name, **self._fields, "world": self._world}
        return {**top, "nodes": self._nodes, "edges": self._edges, **probes}

    def deployment(self) -> Deployment:
        """The same, checked as a deployment file is. Raises `HieraxError` if that finds something wrong."""
        document = Document(f"hierarchy {self.name!r}", self.root(), {})
        deployment = deployment_of(document, Path(f"{self.name}.yaml"))
        return replace(
            deployment,
            import_paths=tuple(dict.fromkeys((*script_folders(), *deployment.import_paths))),
            modules=tuple(sorted({*deployment.modules, *script_modules()})),  # also for what is attached later
        )

    def text(self) -> str:
        """The same as YAML, not checked."""
        return yaml_of(self.root())

    def to_yaml(self, file: str | Path | None = None) -> str:
        """The deployment file that says the same, checked; written to `file` where that is given.

        Raises `HieraxError` if something is wrong, or the file exists."""
        self.deployment()
        text = self.text()
        if file is not None:
            try:
                with Path(file).open("x", encoding="utf-8") as opened:
                    opened.write(text)
            except OSError as error:
                raise HierarchyError(f"{file}: cannot be written: {error.strerror or error}") from error
        return text


def _function(given: Code, what: str) -> Any:
    target, parameters = named(given, what)
    return {"function": target, "parameters": parameters} if parameters else target


def _plain(value: Any) -> Any:
    """A field's value as a file has it: with lists in the place of tuples and arrays, and Python's own numbers."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def _makes_world(of: Code) -> bool:
    while isinstance(of, partial):
        of = of.func
    return makes(of, World)


def _check_fields(fields: Mapping[str, Any], otherwise: Mapping[str, str], what: str) -> None:
    """Raise `HierarchyError` if one of the fields is given in another way."""
    for field in fields:
        if field in otherwise:
            raise HierarchyError(f"{what}: {field}: expected it {otherwise[field]}, not as a field")
