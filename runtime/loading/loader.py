"""Code by name: from a roster to nodes, edge functions and probes.

Node processes use this; it imports nothing heavy."""

import functools
import importlib
import inspect
import pkgutil
import re
import sys
import traceback
from collections.abc import Callable, Iterable
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType, SimpleNamespace, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from hierax.runtime.core.binding import BoundNode, OperatorSetting, check_signature, require_no_world
from hierax.runtime.core.errors import FAILURES, HieraxError, PlacedError
from hierax.runtime.core.graph import neighbours
from hierax.runtime.core.hierarchy import BoundEdge, Edge, Hierarchy
from hierax.runtime.core.node import Node, World
from hierax.runtime.core.probe import Probe
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.arguments import wrong_argument
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import FUNCTIONS, Reference, Roster, RosterEdge
from hierax.schemas.values import encode_value


class LoadError(PlacedError):
    """What a roster names cannot be loaded. `what` is wrong, with what was expected, and the nearest valid name;
    `where` is the path in the roster, which is also that in the deployment file, as ``nodes.world.parameters.noise`` or
    ``edges.world -> arm.sense.function``."""


_deployments_paths: list[str] = []  # folders of modules that deployments have brought to this process
_newest_paths: list[str] = []  # of the last one, whether it has brought them or they were there


def extend_import_path(paths: Iterable[str]) -> None:
    """Let modules of a deployment be found in further folders, behind all that is there already."""
    _newest_paths[:] = paths
    for path in _newest_paths:
        if path not in sys.path:
            sys.path.append(path)
            _deployments_paths.append(path)
    importlib.invalidate_caches()


def load(target: str, where: str, allowance: Allowance) -> Any:
    """The object that ``package.module:name`` names, which the field at `where` says; the allowance is asked before.
    Raises `NotAllowedError` if it may not be loaded, and `LoadError` if there is no such module or name (with the
    nearest one), the module only imports it from one that is not allowed, or the module's import raised."""
    allowance.check(target, where)
    module_name, _, name = target.partition(":")
    module = _import(module_name, where)
    if not hasattr(module, name):
        public = [known for known in dir(module) if not known.startswith("_")]
        raise LoadError(f"there is no {name!r} in module {module_name!r}{did_you_mean(name, public)}", where)
    found = getattr(module, name)
    if isinstance(found, ModuleType):
        raise LoadError(f"{name!r} in module {module_name!r} is a module itself; name it before the colon", where)
    _check_home(found, module_name, name, where, allowance)
    return found


def _check_home(found: Any, module_name: str, name: str, where: str, allowance: Allowance) -> None:
    """What a module has only imported is allowed by the module that defines it; a package offers what is inside it."""
    home = found.__module__ if inspect.isclass(found) or inspect.isroutine(found) else None
    if not isinstance(home, str) or home == module_name or home.startswith(f"{module_name}."):
        return
    if not allowance.covers(home):
        instead = f"{home}:{found.__qualname__}"
        raise LoadError(f"module {module_name!r} only imports {name!r}; name it as {instead!r}", where)


def build_node(reference: Reference, where: str, allowance: Allowance, is_world: bool = False) -> Node:
    """Build a node, or a `World`, of its class and parameters; `where` is its path in the file, ``nodes.NAME``. Raises
    `NotAllowedError` or `LoadError` as `load` does, or if it is no class of nodes, which is found out before that is
    called; or a parameter is unknown, lacks or is refused by it."""
    node: Node = _build(reference, where, allowance, World if is_world else Node)
    return node


def build_probe(reference: Reference, where: str, allowance: Allowance) -> Probe:
    """Build a probe; `where` is its path in the file, ``probes[i]``. Raises as `build_node` does."""
    probe: Probe = _build(reference, where, allowance, Probe)
    return probe


def build_edge(edge: RosterEdge, allowance: Allowance, side: str = "both") -> Edge:
    """Build an edge's functions; of its side ``lower`` φ only, of ``upper`` ψ and ϱ, of ``both`` all three. Raises
    `NotAllowedError` or `LoadError` as `load` does, or if what is named is no function of the edge's kind, and no class
    whose objects are, which is found out before it is called."""
    where = f"edges.{edge.lower} -> {edge.upper}"
    wanted = {"lower": ("sense",), "upper": ("task", "context"), "both": FUNCTIONS}[side]
    references = {kind: getattr(edge, kind) for kind in wanted if getattr(edge, kind) is not None}
    functions = {kind: _edge_function(each, where, kind, allowance) for kind, each in references.items()}
    return Edge(edge.lower, edge.upper, **functions)


def build_hierarchy(roster: Roster, setting: OperatorSetting, allowance: Allowance) -> Hierarchy:
    """Build all nodes and edges in this process. Raises `NotAllowedError` if something may not be loaded (then nothing
    is), `LoadError` if something cannot be loaded, or an operator not be called, and `HierarchyError` if they form no
    hierarchy."""
    allowance.check_all(roster)
    nodes = {
        name: build_node(reference, f"nodes.{name}", allowance, is_world=name == roster.world)
        for name, reference in roster.nodes.items()
    }
    edges = [build_edge(edge, allowance) for edge in roster.edges]
    below, above = neighbours(edge.pair for edge in edges)
    for name, node in nodes.items():  # each by itself first: these errors know their place
        bind_node(name, node, roster.world, below.get(name, ()), above.get(name, ()), setting)
    for edge in edges:
        bind_edge(edge, setting)
    return Hierarchy(nodes, roster.world, edges, setting)


def load_function(target: str, where: str, allowance: Allowance) -> Callable[..., Any]:
    """A function by name. Raises `NotAllowedError` or `LoadError` as `load` does, or if it is no function."""
    found = load(target, where, allowance)
    if not inspect.isfunction(found):
        raise LoadError(f"expected a function, but {target} is {_shown(found)}", where)
    return found


def bind_node(
    name: str, node: Node, world: str, below: tuple[str, ...], above: tuple[str, ...], setting: OperatorSetting
) -> BoundNode:
    """A node with its neighbours, ready to be called; `LoadError` if it cannot be, or another than N₀ is a world."""
    where = f"nodes.{name}"
    try:
        if name != world:
            require_no_world(name, node)
        return BoundNode(name, node, below, above, setting)
    except HieraxError as error:
        raise LoadError(str(error).removeprefix(f"{name}: "), where) from error


def bind_edge(edge: Edge, setting: OperatorSetting) -> BoundEdge:
    """An edge's functions, ready to be called. Raises `LoadError` if one of them cannot be."""
    name = f"{edge.lower}->{edge.upper}"
    try:
        return BoundEdge.of(edge, setting)
    except HieraxError as error:
        raise LoadError(str(error).removeprefix(f"{name}: "), f"edges.{edge.lower} -> {edge.upper}") from error


def check_initial_belief(name: str, node: Node) -> None:
    """Whether s⁰ can be had and travel. Raises `LoadError` if it raised, or gave no value."""
    where = f"nodes.{name}"
    try:
        encode_value(node.initial_belief())
    except SchemaError as error:
        raise LoadError(f"the initial belief is no value: {error}", where) from error
    except FAILURES as error:
        raise LoadError(f"initial_belief raised {_told(error)}", where) from error


def _edge_function(reference: Reference, edge: str, kind: str, allowance: Allowance) -> Callable[..., Any]:
    """An edge's function, or an object of a class in its place; looked at before the class is called."""
    where = f"{edge}.{kind}"
    target = load(reference.target, f"{where}.function", allowance)
    if inspect.isclass(target):
        _check_signature(functools.partial(_call_of(target, reference, where), None), edge, kind)
        made: Callable[..., Any] = _call(target, reference, where)
        return made
    if not inspect.isfunction(target):
        raise LoadError(_no_edge_function(target, reference), f"{where}.function")
    _check_given(target, reference, where)
    function = functools.partial(target, **reference.parameters) if reference.parameters else target
    _check_signature(function, edge, kind)
    return function


def _call_of(target: type, reference: Reference, where: str) -> Callable[..., Any]:
    """What is called when an object of a class is."""
    call = next((vars(base)["__call__"] for base in target.__mro__ if "__call__" in vars(base)), None)
    if not inspect.isfunction(call) or issubclass(target, (Node, Probe)):
        raise LoadError(_no_edge_function(target, reference), f"{where}.function")
    return call


def _no_edge_function(found: Any, reference: Reference) -> str:
    return f"expected a function, or a class whose objects can be called, but {reference.target} is {_shown(found)}"


def _check_signature(function: Callable[..., Any], edge: str, kind: str) -> None:
    try:
        check_signature(function, kind)
    except HieraxError as error:
        raise LoadError(str(error), edge) from error


def _build(reference: Reference, where: str, allowance: Allowance, kind: type) -> Any:
    """A node or probe; what is named is called once it is known to be a class of that kind, or to give one."""
    field = f"{where}.class"
    target = load(reference.target, field, allowance)
    if not makes(target, kind):
        raise LoadError(_no_class(target, reference, kind), field)
    made = _call(target, reference, where, "class")
    if not isinstance(made, kind):
        raise LoadError(f"{reference.target} gives a {type(made).__name__}, no {kind.__name__}", field)
    return made


def makes(target: Any, kind: type) -> bool:
    """Whether something is a class of a kind; or a function that says by its annotation that it gives an object of that
    kind, or of some such kinds. Its other annotations need not be known here."""
    if inspect.isclass(target):
        return issubclass(target, kind)
    if not inspect.isfunction(target):
        return False
    try:
        returned = SimpleNamespace(__annotations__={"return": target.__annotations__["return"]})
        said = get_type_hints(returned, inspect.unwrap(target).__globals__)["return"]
    except Exception:  # whatever an annotation's evaluation raises
        return False
    given = get_args(said) if isinstance(said, UnionType) or get_origin(said) is Union else (said,)
    return all(inspect.isclass(each) and issubclass(each, kind) for each in given)


def _no_class(found: Any, reference: Reference, kind: type) -> str:
    if kind is World and inspect.isclass(found) and issubclass(found, Node):
        return f"the world's class must derive from World, {found.__name__} does not"
    what = f"expected a class derived from {kind.__name__}, but {reference.target} is {_shown(found)}"
    return f"{what}; one that makes nodes says so: '-> {kind.__name__}'" if inspect.isfunction(found) else what


def _call(target: Callable[..., Any], reference: Reference, where: str, field: str = "function") -> Any:
    """Call a class with its parameters, errors mapped."""
    if inspect.isabstract(target):
        lacking = ", ".join(sorted(vars(target)["__abstractmethods__"]))
        raise LoadError(f"{reference.target} lacks {lacking}, which every subclass must define", f"{where}.{field}")
    _check_given(target, reference, where)
    for parameter in _parameters(target):
        can_be_named = parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
        if can_be_named and parameter.default is parameter.empty and parameter.name not in reference.parameters:
            raise LoadError(f"missing; {reference.target} needs it", f"{where}.parameters.{parameter.name}")
    try:
        return target(**reference.parameters)
    except (HieraxError, ValueError, OSError) as error:
        text = str(error) or type(error).__name__
        name = re.split(r"\W", text, maxsplit=1)[0]  # the parameter that it names first
        if name in reference.parameters:
            raise LoadError(text.removeprefix(f"{name}: "), f"{where}.parameters.{name}") from error
        raise LoadError(text, f"{where}.parameters") from error
    except FAILURES as error:
        raise LoadError(f"{reference.target} raised {_told(error)}", f"{where}.parameters") from error


def _check_given(target: Callable[..., Any], reference: Reference, where: str) -> None:
    """Whether all parameters that are given are known, and of the annotated types."""
    known = _parameters(target)
    names = [parameter.name for parameter in known if parameter.kind is not parameter.POSITIONAL_ONLY]
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in known)
    for name in () if takes_any else reference.parameters:
        if name not in names:
            nearest = did_you_mean(name, names, "it takes") or "; it takes none"
            raise LoadError(f"{reference.target} has no such parameter{nearest}", f"{where}.parameters.{name}")
    wrong = wrong_argument(target, reference.parameters)
    if wrong is not None:
        name, what = wrong
        raise LoadError(what, f"{where}.parameters.{name}")


def _parameters(target: Callable[..., Any]) -> list[inspect.Parameter]:
    try:
        return list(inspect.signature(target).parameters.values())
    except (TypeError, ValueError):  # some callables written in C tell nothing
        return [inspect.Parameter("parameters", inspect.Parameter.VAR_KEYWORD)]


def _import(name: str, where: str) -> ModuleType:
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        lacking = error.name or name
        if lacking != name and not name.startswith(f"{lacking}."):
            raise LoadError(f"module {name!r} needs module {lacking!r}, which is not installed", where) from error
        raise LoadError(f"there is no module {lacking!r}{_nearest_module(lacking)}", where) from error
    except FAILURES as error:
        raise LoadError(f"importing {name!r} raised {_told(error)}", where) from error
    _check_whose(name.partition(".")[0], where)
    return module


def _check_whose(name: str, where: str) -> None:
    """Raises `LoadError` where a module is another deployment's, which this process has run before, and the newest one
    has one of that name, too: Python imports one alone."""
    file = getattr(sys.modules.get(name), "__file__", None)
    others = [path for path in _deployments_paths if path not in _newest_paths]
    if file is None or not any(_is_in(file, name, path) for path in others):
        return
    own = PathFinder.find_spec(name, _newest_paths)
    if own is None or own.origin in (None, file):
        return
    what = f"module {name!r} of another deployment, {file}, is in this process already, beside {own.origin}"
    raise LoadError(f"{what}; run one of them in a process of its own, or name its modules otherwise", where)


def _is_in(file: str, name: str, folder: str) -> bool:
    """Whether a file is that of a module of a name in a folder: a module, or a package."""
    return Path(file) in (Path(folder) / f"{name}.py", Path(folder) / name / "__init__.py")


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


def _shown(found: Any) -> str:
    """What something is that is not what was expected."""
    if inspect.isclass(found):
        known = next((kind.__name__ for kind in (World, Node, Probe) if issubclass(found, kind)), "")
        return f"a {known}" if known else "another class"
    return "a function" if inspect.isfunction(found) else f"a {type(found).__name__}"
