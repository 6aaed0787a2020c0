"""Code by name: from a roster to nodes, edge functions and probes.

Node processes use this; it imports nothing heavy.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import pkgutil
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import Any

from hierax.runtime.core.binding import BoundNode, Setting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.graph import Pair
from hierax.runtime.core.hierarchy import BoundEdge, Edge, Hierarchy, neighbours_above, neighbours_below
from hierax.runtime.core.node import Node, World
from hierax.runtime.core.probe import Probe
from hierax.runtime.nearest import did_you_mean
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import Reference, Roster, RosterEdge
from hierax.schemas.values import encode_value


class LoadError(HieraxError):
    """What a roster names cannot be loaded.

    Attributes:
        what: what is wrong, what was expected, and the nearest valid name.
        where: the path in the roster, which is also that in the deployment file:
            ``nodes.world.parameters.noise``, ``edges.world -> arm.sense.function``.
    """

    def __init__(self, what: str, where: str) -> None:
        self.what = what
        self.where = where
        super().__init__(f"{where}: {what}")


def extend_import_path(paths: Iterable[str]) -> None:
    """Let modules be found in further folders, behind all that is there already."""
    for path in paths:
        if path not in sys.path:
            sys.path.append(path)
    importlib.invalidate_caches()


def load(target: str, where: str) -> Any:
    """The object that ``package.module:name`` names.

    Raises:
        LoadError: there is no such module or name (with the nearest one), or the
            module's import raised.
    """
    module_name, _, name = target.partition(":")
    found: Any = _import(module_name, where)
    inside = f"module {module_name!r}"
    for part in name.split("."):
        if not hasattr(found, part):
            public = [known for known in dir(found) if not known.startswith("_")]
            raise LoadError(f"there is no {part!r} in {inside}{did_you_mean(part, public)}", where)
        found = getattr(found, part)
        inside = f"{part!r}"
        if isinstance(found, ModuleType):
            raise LoadError(f"{part!r} in module {module_name!r} is a module itself; name it before the colon", where)
    _check_home(found, module_name, name, where)
    return found


def _check_home(found: Any, module_name: str, name: str, where: str) -> None:
    """What a module has imported from another package is named there: which code may be loaded is decided by module."""
    home = found.__module__ if inspect.isclass(found) or inspect.isroutine(found) else None
    if isinstance(home, str) and home.partition(".")[0] != module_name.partition(".")[0]:
        instead = f"{home}:{found.__qualname__}"
        raise LoadError(f"module {module_name!r} only imports {name!r}; name it as {instead!r}", where)


def build_node(reference: Reference, where: str) -> Node:
    """Build a node.

    Args:
        reference: its class and parameters.
        where: its path in the deployment file, ``nodes.NAME``.

    Raises:
        LoadError: see `load`; or a parameter is unknown, lacks or is refused by the
            class, or the result is no `Node`.
    """
    node = _build(reference, where, "class")
    if not isinstance(node, Node):
        raise LoadError(f"expected a class derived from Node, {_not_a(node, reference)}", f"{where}.class")
    return node


def build_probe(reference: Reference, where: str) -> Probe:
    """Build a probe.

    Args:
        reference: its class and parameters.
        where: its path in the deployment file, ``probes[i]``.

    Raises:
        LoadError: as `build_node`.
    """
    probe = _build(reference, where, "class")
    if not isinstance(probe, Probe):
        raise LoadError(f"expected a class derived from Probe, {_not_a(probe, reference)}", f"{where}.class")
    return probe


def build_edge(edge: RosterEdge, side: str = "both") -> Edge:
    """Build an edge's functions.

    Args:
        edge: by names.
        side: ``lower`` builds φ only, ``upper`` ψ and ϱ, ``both`` all three.

    Raises:
        LoadError: as `build_node`; or what is named cannot be called.
    """
    where = f"edges.{edge.lower} -> {edge.upper}"
    wanted = {"lower": ("sense",), "upper": ("task", "context"), "both": ("sense", "task", "context")}[side]
    functions: dict[str, Callable[..., Any]] = {}
    for kind in wanted:
        reference = getattr(edge, kind)
        if reference is not None:
            functions[kind] = _load_function(reference, f"{where}.{kind}")
    return Edge(edge.lower, edge.upper, **functions)


def build_hierarchy(roster: Roster, setting: Setting) -> Hierarchy:
    """Build all nodes and edges in this process.

    Raises:
        LoadError: something cannot be loaded, or an operator cannot be called.
        HierarchyError: they form no hierarchy.
    """
    nodes = {name: build_node(reference, f"nodes.{name}") for name, reference in roster.nodes.items()}
    edges = [build_edge(edge) for edge in roster.edges]
    pairs = [edge.pair for edge in edges]
    for name, node in nodes.items():  # each by itself first: these errors know their place
        bind_node(name, node, roster.world, pairs, setting)
    for edge in edges:
        bind_edge(edge, setting)
    return Hierarchy(nodes, roster.world, edges, setting)


def bind_node(name: str, node: Node, world: str, pairs: Sequence[Pair], setting: Setting) -> BoundNode:
    """A node with its neighbours, ready to be called.

    Raises:
        LoadError: an operator cannot be called, λ(∅) is not π⁰, or N₀ is no world.
    """
    where = f"nodes.{name}"
    if name == world and not isinstance(node, World):
        raise LoadError(f"the world's class must derive from World, {type(node).__name__} does not", f"{where}.class")
    try:
        return BoundNode(name, node, neighbours_below(name, pairs), neighbours_above(name, pairs), setting)
    except HieraxError as error:
        raise LoadError(str(error).removeprefix(f"{name}: "), where) from error


def bind_edge(edge: Edge, setting: Setting, side: str = "both") -> BoundEdge:
    """An edge's functions on one side or both, ready to be called.

    Raises:
        LoadError: one of them cannot be called.
    """
    name = f"{edge.lower}->{edge.upper}"
    try:
        return BoundEdge.of(edge, setting, side)
    except HieraxError as error:
        raise LoadError(str(error).removeprefix(f"{name}: "), f"edges.{edge.lower} -> {edge.upper}") from error


def check_initial_belief(name: str, node: Node) -> None:
    """Whether s⁰ can be had and travel.

    Raises:
        LoadError: it raised, or gave no value.
    """
    where = f"nodes.{name}"
    try:
        encode_value(node.initial_belief())
    except SchemaError as error:
        raise LoadError(f"the initial belief is no value: {error}", where) from error
    except Exception as error:
        raise LoadError(f"initial_belief raised {_told(error)}", where) from error


def _load_function(reference: Reference, where: str) -> Callable[..., Any]:
    target = load(reference.target, f"{where}.function")
    if inspect.isclass(target):
        function: Any = _call(target, reference, where)
    else:
        function = target
    if not callable(function):
        what = f"expected a function, or a class whose objects can be called, {_not_a(function, reference)}"
        raise LoadError(what, f"{where}.function")
    if inspect.isclass(target) or not reference.parameters:
        return function  # type: ignore[no-any-return]
    _check_names(target, reference, where)
    return functools.partial(function, **reference.parameters)


def _build(reference: Reference, where: str, field: str) -> Any:
    target = load(reference.target, f"{where}.{field}")
    if not callable(target):
        raise LoadError(f"expected a class, {_not_a(target, reference)}", f"{where}.{field}")
    return _call(target, reference, where, field)


def _call(target: Callable[..., Any], reference: Reference, where: str, field: str = "function") -> Any:
    """Call a class with its parameters, errors mapped."""
    if inspect.isabstract(target):
        lacking = ", ".join(sorted(vars(target)["__abstractmethods__"]))
        raise LoadError(f"{reference.target} lacks {lacking}, which every subclass must define", f"{where}.{field}")
    _check_names(target, reference, where)
    _check_complete(target, reference, where)
    try:
        return target(**reference.parameters)
    except (HieraxError, ValueError, OSError) as error:
        raise _refused(error, reference, f"{where}.parameters") from error
    except Exception as error:
        raise LoadError(f"{reference.target} raised {_told(error)}", f"{where}.parameters") from error


def _refused(error: Exception, reference: Reference, where: str) -> LoadError:
    """What a class says of its parameters, at the one that it names first."""
    text = str(error) or type(error).__name__
    first = re.match(r"\w*", text)
    name = first[0] if first else ""
    if name in reference.parameters:
        return LoadError(text.removeprefix(f"{name}: "), f"{where}.{name}")
    return LoadError(text, where)


def _check_names(target: Callable[..., Any], reference: Reference, where: str) -> None:
    known = _parameters(target)
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in known):
        return
    names = [parameter.name for parameter in known if parameter.kind is not parameter.POSITIONAL_ONLY]
    for name in reference.parameters:
        if name not in names:
            nearest = did_you_mean(name, names, "it takes") or "; it takes none"
            raise LoadError(f"{reference.target} has no such parameter{nearest}", f"{where}.parameters.{name}")


def _check_complete(target: Callable[..., Any], reference: Reference, where: str) -> None:
    for parameter in _parameters(target):
        needed = parameter.default is parameter.empty and parameter.kind in (
            parameter.POSITIONAL_OR_KEYWORD,
            parameter.KEYWORD_ONLY,
        )
        if needed and parameter.name not in reference.parameters:
            raise LoadError(f"missing; {reference.target} needs it", f"{where}.parameters.{parameter.name}")


def _parameters(target: Callable[..., Any]) -> list[inspect.Parameter]:
    try:
        return list(inspect.signature(target).parameters.values())
    except (TypeError, ValueError):  # some callables written in C tell nothing
        return [inspect.Parameter("parameters", inspect.Parameter.VAR_KEYWORD)]


def _import(name: str, where: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        lacking = error.name or name
        if lacking != name and not name.startswith(f"{lacking}."):
            raise LoadError(f"module {name!r} needs module {lacking!r}, which is not installed", where) from error
        raise LoadError(f"there is no module {lacking!r}{_nearest_module(lacking)}", where) from error
    except (Exception, SystemExit) as error:
        raise LoadError(f"importing {name!r} raised {_told(error)}", where) from error


def _nearest_module(name: str) -> str:
    """A module with a similar name in the same package."""
    package, _, last = name.rpartition(".")
    folders = getattr(sys.modules.get(package), "__path__", None) if package else None
    if package and folders is None:
        return f"; {package!r} is no package"
    names = {found.name for found in pkgutil.iter_modules(None if folders is None else list(folders))}
    names |= {known.rpartition(".")[2] for known in list(sys.modules) if known.rpartition(".")[0] == package}
    nearest = did_you_mean(last, names)
    if "did you mean" in nearest or package:
        return nearest.replace("did you mean '", f"did you mean '{package}." if package else "did you mean '")
    return "; it is looked for among the installed ones, beside the deployment file and in the current folder"


def _told(error: BaseException) -> str:
    """An error's type, text, and the place that raised it."""
    text = " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__}: {text}"
    place = f" ({frames[-1].filename}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{place}" if text else f"{type(error).__name__}{place}"


def _not_a(given: Any, reference: Reference) -> str:
    kind = f"the module {given.__name__}" if isinstance(given, ModuleType) else f"a {type(given).__name__}"
    return f"but {reference.target} gives {kind}"
