"""Reading a deployment file: text to tree, ``--set``, ``${NAME}``, models, roster."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import check_graph
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.deployment.deployment import Deployment, RestartPolicy, ViewSpec
from hierax.runtime.deployment.document import Document
from hierax.runtime.deployment.errors import DeploymentError
from hierax.runtime.deployment.locating import find_file, import_paths, read_text
from hierax.runtime.deployment.models import DeploymentModel, ViewModel, split_edge
from hierax.runtime.deployment.overrides import apply_override
from hierax.runtime.deployment.parameters import substitute
from hierax.runtime.deployment.parts import check_known, reference, restart_policy, roster_edges, roster_nodes
from hierax.runtime.deployment.paths import Keys
from hierax.runtime.deployment.tree import read_tree
from hierax.runtime.deployment.validation import first_error
from hierax.runtime.loading.allowance import module_of
from hierax.schemas.roster import FUNCTIONS, ProbeSpec, Roster


def read_deployment(file: str | Path, overrides: Sequence[str] = ()) -> Deployment:
    """Read a deployment file; nothing of what it names is imported.

    Args:
        file: the path of a file, or the name of a shipped deployment.
        overrides: as ``--set`` has them, ``PATH=VALUE``, in order.

    Raises:
        DeploymentError: the file, or an override, is wrong: file, line, field, what was expected, and the nearest valid
            name.
    """
    path = find_file(file)
    document = read_document(path, "hierarchy, world, nodes and edges")
    for override in overrides:
        apply_override(document, override)
    root = substitute(document)
    try:
        model = DeploymentModel.model_validate(root)
    except ValidationError as error:
        raise first_error(error, document, root) from error
    roster = _roster(model, document)
    restart = restart_policy(model.restart, RestartPolicy(), document, ("restart",))
    return Deployment(
        path=path,
        name=model.hierarchy,
        description=model.description,
        epochs=model.epochs,
        roster=roster,
        probes=_probes(model, document),
        modules=_modules(model),
        restarts={name: restart_policy(node, restart, document, ("nodes", name)) for name, node in model.nodes.items()},
        restart=restart,
        durability=model.durability,
        epoch_deadline_s=model.epoch_deadline_s,
        on_uncertain_act=model.on_uncertain_act,
        staleness=_staleness(model, document),
        rates_hz={name: node.rate_hz for name, node in model.nodes.items() if node.rate_hz is not None},
        start_timeout_s=model.start_timeout_s,
        zenoh=_zenoh(model.zenoh, path, document),
        low_latency=_low_latency(model, document),
        import_paths=import_paths(path),
        document=document,
        view=_view(model.view),
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


def _roster(model: DeploymentModel, document: Document) -> Roster:
    nodes = roster_nodes(model.nodes, document)
    check_known(model.world, nodes, document, ("world",))
    for name in model.edges:
        for end in split_edge(name):
            check_known(end, nodes, document, ("edges", name))
    edges = roster_edges(model.edges, document)
    try:
        check_graph(model.world, nodes, [edge.pair for edge in edges])
    except HierarchyError as error:
        raise document.error(("edges",), str(error)) from error
    return Roster(model.world, nodes, edges)


def _probes(model: DeploymentModel, document: Document) -> tuple[ProbeSpec, ...]:
    specs = []
    for index, probe in enumerate(model.probes):
        keys: Keys = ("probes", index)
        check_known(probe.node, model.nodes, document, (*keys, "node"))
        specs.append(ProbeSpec(probe.node, reference(probe.target, probe.parameters, document, keys)))
    return tuple(specs)


def _modules(model: DeploymentModel) -> tuple[str, ...]:
    """What the file names, in functions that are not enabled too, and what it lists."""
    targets = [node.target for node in model.nodes.values()] + [probe.target for probe in model.probes]
    for edge in model.edges.values():
        functions = [getattr(edge, kind) for kind in FUNCTIONS]
        targets += [function.function for function in functions if function is not None]
    if model.view.show is not None:
        targets.append(model.view.show)
    return tuple(sorted({*model.modules, *map(module_of, targets)}))


def _view(model: ViewModel) -> ViewSpec:
    if model.layout is None:
        return ViewSpec(model.show)
    columns = [[(cell,) if isinstance(cell, str) else tuple(cell) for cell in column] for column in model.layout]
    return ViewSpec(model.show, tuple(map(tuple, columns)))


def _staleness(model: DeploymentModel, document: Document) -> Staleness:
    staleness = Staleness(model.staleness, model.exact)
    if model.exact and (staleness.barrier or staleness.free):
        raise document.error(("exact",), "means something only with a staleness of 1 or more")
    for name, node in model.nodes.items():
        if node.rate_hz is not None and not staleness.free:
            raise document.error(("nodes", name, "rate_hz"), "nodes have rates only in free running (staleness: null)")
    return staleness


def _low_latency(model: DeploymentModel, document: Document) -> bool:
    if model.low_latency and model.staleness != 0:
        what = "goes with a staleness of 0 only: nodes that do not wait for one another may fill its links"
        raise document.error(("low_latency",), what)
    return model.low_latency


def _zenoh(value: str | dict[str, Any] | None, path: Path, document: Document) -> dict[str, Any] | str | None:
    if not isinstance(value, str) or value.lstrip().startswith("{"):
        return value
    file = (path.parent / value).resolve()
    if not file.is_file():
        raise document.error(("zenoh",), f"there is no file {str(file)!r}; expected a file, JSON5 text or a map")
    return str(file)
