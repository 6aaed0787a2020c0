"""Reading a deployment file: text to tree, ``--set``, ``${NAME}``, models, roster."""

import fnmatch
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import check_graph
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.deployment import models
from hierax.runtime.deployment.deployment import (
    Deployment,
    DeploymentError,
    Document,
    Keys,
    ProcessTerms,
    ViewSpec,
    find_file,
    import_paths,
    read_text,
)
from hierax.runtime.deployment.hosts import check_together, hosts_of, placed_on
from hierax.runtime.deployment.model_errors import first_error
from hierax.runtime.deployment.parameters import apply_override, substitute
from hierax.runtime.deployment.rates import TOGETHER, rates_of
from hierax.runtime.deployment.tree import read_tree
from hierax.runtime.host.scheduling import REAL_TIME
from hierax.runtime.host.zenoh_settings import names_file
from hierax.runtime.loading.allowance import module_of
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import FUNCTIONS, ProbeSpec, Reference, Roster, RosterEdge
from hierax.schemas.values import decode_value, encode_value

_AS_SAID = (
    "description",
    "epochs",
    "durability",
    "epoch_deadline_s",
    "on_uncertain_act",
    "start_timeout_s",
    "low_latency",
    "open",
    "insecure",
    "certificates_s",
    "late",
)
"""Fields of the deployment that are those of the file."""


def read_deployment(file: str | Path, overrides: Sequence[str] = ()) -> Deployment:
    """Read a deployment file, by its path or the name of a shipped one; nothing of what it names is imported. Overrides
    are as ``--set`` has them, ``PATH=VALUE``, in order. Raises `DeploymentError` if the file, or an override, is wrong:
    file, line, field, what was expected, and the nearest valid name."""
    path = find_file(file)
    document = read_document(path, "hierarchy, world, nodes and edges")
    for override in overrides:
        apply_override(document, override)
    return deployment_of(document, path)


def deployment_of(document: Document, path: Path) -> Deployment:
    """What a document says, whose file has this path. Raises `DeploymentError` as `read_deployment` does."""
    root = substitute(document)
    try:
        model = models.DeploymentModel.model_validate(root)
    except ValidationError as error:
        raise first_error(error, document, root) from error
    roster = _roster(model, document)
    turns, timing = rates_of(model, document)
    roster = replace(roster, turns=turns, timing=timing)
    restart = process_terms(model.restart, ProcessTerms(), document, ("restart",))
    staleness = _staleness(model, document)
    hosts = hosts_of(model, document)
    processes, placed = _processes(model, document), placed_on(model, hosts, document)
    if apart := check_together(processes, placed):
        raise document.error(("place",), apart)
    return Deployment(
        path=path,
        name=model.hierarchy,
        roster=roster,
        probes=_probes(model, document),
        modules=_modules(model),
        terms=node_terms(model.nodes, lambda name: restart, document, staleness, model.world, timing is not None),
        restart=restart,
        staleness=staleness,
        zenoh=_zenoh(model.zenoh, path, document),
        import_paths=import_paths(path),
        document=document,
        view=_view(model.view),
        processes=processes,
        hosts=hosts,
        placed=placed,
        **{name: getattr(model, name) for name in _AS_SAID},
    )


def read_document(path: Path, fields: str) -> Document:
    """A YAML file whose root is a map, with these fields, as errors say. Raises `DeploymentError` if it is none."""
    tree = read_tree(read_text(path), str(path))
    if tree.value is None:
        raise DeploymentError(f"is empty; expected a map with {fields}", str(path))
    if not isinstance(tree.value, dict):
        given = "a list" if isinstance(tree.value, list) else f"{tree.value!r:.60}"
        raise DeploymentError(f"expected a map with {fields}, got {given}", f"{path}:{tree.lines[()]}")
    return Document(str(path), tree.value, tree.lines)


def _roster(model: models.DeploymentModel, document: Document) -> Roster:
    nodes = roster_nodes(model.nodes, document)
    check_known(model.world, nodes, document, ("world",))
    for name in model.edges:
        for end in models.split_edge(name):
            check_known(end, nodes, document, ("edges", name))
    edges = roster_edges(model.edges, document)
    try:
        check_graph(model.world, nodes, [edge.pair for edge in edges])
    except HierarchyError as error:
        raise document.error(("edges",), str(error)) from error
    return Roster(model.world, nodes, edges)


def _probes(model: models.DeploymentModel, document: Document) -> tuple[ProbeSpec, ...]:
    probes = []
    for index, probe in enumerate(model.probes):
        check_known(probe.node, model.nodes, document, ("probes", index, "node"))
        named = reference(probe.target, probe.parameters, document, ("probes", index))
        probes.append(ProbeSpec(probe.node, named))
    return tuple(probes)


def _modules(model: models.DeploymentModel) -> tuple[str, ...]:
    """What the file names, in functions that are not enabled too, and what it lists."""
    targets = [node.target for node in model.nodes.values()] + [probe.target for probe in model.probes]
    for edge in model.edges.values():
        functions = [getattr(edge, kind) for kind in FUNCTIONS]
        targets += [function.function for function in functions if function is not None]
    if model.view.show is not None:
        targets.append(model.view.show)
    return tuple(sorted({*model.modules, *map(module_of, targets)}))


def _processes(model: models.DeploymentModel, document: Document) -> dict[str, tuple[str, ...]]:
    """The nodes of each process, by its name. Raises `DeploymentError` if there is none of a name, or one is in two."""
    placed: dict[str, str] = {}
    for process, names in model.processes.items():
        if not names:
            raise document.error(("processes", process), "is empty; expected names of nodes")
        for index, name in enumerate(names):
            keys = ("processes", process, index)
            found = sorted(fnmatch.filter(model.nodes, name)) if "*" in name else [name]
            if not found:
                raise document.error(keys, f"there is no node like {name!r}; the nodes are {', '.join(model.nodes)}")
            for node in found:
                check_known(node, model.nodes, document, keys)
                if placed.setdefault(node, process) != process:
                    what = f"{node!r} is in process {placed[node]!r} already; a node is in one process"
                    raise document.error(keys, what)
    for process in model.processes:
        if process in model.nodes and placed.get(process) != process:
            what = f"a node of this name is in another process; expected another name, or {process!r} among its nodes"
            raise document.error(("processes", process), what)
    return {process: tuple(node for node in placed if placed[node] == process) for process in model.processes}


def _view(model: models.ViewModel) -> ViewSpec:
    if model.layout is None:
        return ViewSpec(model.show)
    columns = [[(cell,) if isinstance(cell, str) else tuple(cell) for cell in column] for column in model.layout]
    return ViewSpec(model.show, tuple(map(tuple, columns)))


def _staleness(model: models.DeploymentModel, document: Document) -> Staleness:
    staleness = Staleness(model.staleness)
    if "late" in model.model_fields_set and not (staleness.barrier and model.nodes[model.world].rate_hz):
        what = f"means something only where the world has a rate, with the barrier: nodes.{model.world}.rate_hz"
        raise document.error(("late",), what)
    if model.low_latency and not staleness.barrier:
        what = "goes with a staleness of 0 only: nodes that do not wait for one another may fill its links"
        raise document.error(("low_latency",), what)
    return staleness


def _zenoh(value: str | dict[str, Any] | None, path: Path, document: Document) -> dict[str, Any] | str | None:
    if not names_file(value):
        return value
    file = path.parent / value
    if not file.is_file():
        raise document.error(("zenoh",), f"there is no file {str(file)!r}; expected a file, JSON5 text or a map")
    return str(file.resolve())


def roster_nodes(given: Mapping[str, models.NodeModel], document: Document) -> dict[str, Reference]:
    """Classes and parameters by name. Raises `DeploymentError` if a parameter is no value."""
    return {name: reference(node.target, node.parameters, document, ("nodes", name)) for name, node in given.items()}


def roster_edges(given: Mapping[str, models.EdgeModel], document: Document) -> tuple[RosterEdge, ...]:
    """Edges, by names, without functions that are not enabled. Raises `DeploymentError` if a parameter is no value."""
    edges = []
    for name, edge in given.items():
        functions = {kind: getattr(edge, kind) for kind in FUNCTIONS}
        references = {
            kind: reference(each.function, each.parameters, document, ("edges", name, kind))
            for kind, each in functions.items()
            if each is not None and each.enabled
        }
        lower, upper = models.split_edge(name)
        edges.append(RosterEdge(lower, upper, **references, delay=edge.delay, gather=edge.gather))
    return tuple(sorted(edges, key=lambda edge: edge.pair))


def reference(target: str, parameters: Mapping[str, Any], document: Document, keys: Keys) -> Reference:
    """A reference with parameters as after travelling, lists as tuples; `DeploymentError` if one is no value."""
    try:
        travelled = decode_value(encode_value(parameters))
    except SchemaError as error:
        raise document.error((*keys, "parameters"), str(error)) from error
    return Reference(target, travelled)


def check_known(name: str, nodes: Iterable[str], document: Document, keys: Keys) -> None:
    """Whether there is a node of this name. Raises `DeploymentError` if there is none, with the nearest one."""
    if name not in nodes:
        raise document.error(keys, f"there is no node {name!r}{did_you_mean(name, nodes, 'the nodes are')}")


RATELESS = "nodes have rates only in free running (staleness: null), the world also with the barrier"


def node_terms(
    nodes: Mapping[str, models.NodeModel],
    otherwise: Callable[[str], ProcessTerms],  # what holds of what a node does not say, by its name
    document: Document,
    staleness: Staleness,  # of the deployment
    world: str,  # its name
    is_rated: bool,  # whether nodes have rates
) -> dict[str, ProcessTerms]:
    """How the processes of nodes are kept. Raises `DeploymentError` if something means nothing where it stands."""
    for name, node in nodes.items():
        if node.rate_hz is not None and not staleness.has_rate(is_world=name == world):
            raise document.error(("nodes", name, "rate_hz"), RATELESS)
        if is_rated and process_terms(node, otherwise(name), document, ("nodes", name)).fails_alone:
            raise document.error(("nodes", name, "on_loss"), f"detach means nothing here: {TOGETHER}")
        if (asked := node.scheduling) and asked.policy not in REAL_TIME and "priority" in asked.model_fields_set:
            what = "means something only with a real-time policy: fifo or rr"
            raise document.error(("nodes", name, "scheduling", "priority"), what)
    return {name: process_terms(node, otherwise(name), document, ("nodes", name)) for name, node in nodes.items()}


def process_terms(said: models.RestartModel, otherwise: ProcessTerms, place: Document, keys: Keys) -> ProcessTerms:
    """What the model of a node, or of all, says of processes, with the rest as other terms have it. The longest delay
    is then at least the first one; if it is given, and shorter, `DeploymentError` names its place in the document."""
    given = {name: getattr(said, name) for name in said.model_fields_set & {each.name for each in fields(ProcessTerms)}}
    first_s = given.get("restart_delay_s", otherwise.restart_delay_s)
    longest_s = given.setdefault("max_restart_delay_s", max(first_s, otherwise.max_restart_delay_s))
    if longest_s < first_s:
        what = f"expected at least restart_delay, {first_s:g}, got {longest_s:g}"
        raise place.error((*keys, "max_restart_delay"), what)
    if given.get("scheduling") is not None:
        given["scheduling"] = given["scheduling"].model_dump()
    return replace(otherwise, **given)
