"""Snippets: YAML with ``nodes`` and ``edges`` as a deployment file has them, for a hierarchy that runs.

``${NAME}`` stands for a parameter of the deployment. Nothing of what a snippet names is imported, and nothing is
checked that depends on the roster which it will find: what nodes there are then, and what may be loaded,
`hierax.runtime.owner.roster_changes` decides."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError

from hierax.runtime.deployment.deployment import Deployment, DeploymentError, Document, ProcessTerms, inside
from hierax.runtime.deployment.model_errors import first_error
from hierax.runtime.deployment.models import SnippetModel, split_edge
from hierax.runtime.deployment.parameters import substitute
from hierax.runtime.deployment.rates import check_gathers, turns_of
from hierax.runtime.deployment.read import node_terms, read_document, roster_edges, roster_nodes
from hierax.runtime.loading.allowance import NotAllowedError
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.owner.roster_changes import ChangeError, next_roster
from hierax.schemas.roster import Attach, Change, Detach, Replace, Roster

FORMS = {"attach": "EPOCH:attach:FILE", "detach": "EPOCH:detach:NAME[:cascade]", "replace": "EPOCH:replace:NAME:FILE"}
"""How each change is written."""

Terms = Mapping[str, ProcessTerms]
_DIGITS = 19
_OF_THE_PLACE = ("rate_hz", "budget_ms", "scheduling")  # what a node keeps when another takes its place


def read_attach(source: str | Path, deployment: Deployment) -> Attach:
    """What attaches nodes to a run of a deployment. The source is the path of a snippet; or the name of a node of the
    deployment file, which is meant with all its edges there. Raises `DeploymentError` if there is no such file or node,
    or the snippet is wrong: file, line, field, what was expected, and the nearest valid name."""
    if _is_node(source, deployment):
        name, roster = str(source), deployment.roster
        turns = {name: roster.turns[name]} if name in roster.turns else {}
        return Attach({name: roster.nodes[name]}, tuple(edge for edge in roster.edges if name in edge.pair), turns)
    return attach_of(_document(source, deployment))


def read_replace(source: str | Path, name: str, deployment: Deployment) -> Replace:
    """What replaces the node of a name. The source is the path of a snippet that has this node alone. Its edges are all
    that the node has from then on; without ``edges``, and without ``every`` and ``offset``, it keeps its own. Raises
    `DeploymentError` as `read_attach` does, or if the snippet has another node."""
    return replace_of(_document(source, deployment), name)


def read_terms(source: str | Path, deployment: Deployment, *, attached: bool = False) -> Mapping[str, ProcessTerms]:
    """What a source of `read_attach` or `read_replace` says of the processes of its nodes. What it leaves out about
    restarts is as ``restart`` at the top of the deployment file has it; but what is attached fails alone (``on_loss:
    detach``) where neither file says what is to follow. What replaces a node keeps the rate, budget and scheduling that
    the file gives that. Raises `DeploymentError` as `read_attach` does."""
    if _is_node(source, deployment):
        own = deployment.terms[str(source)]
        said = _says(deployment, "nodes", str(source))
        return {str(source): own if said else replace(own, on_loss=_otherwise(deployment, attached).on_loss)}
    return terms_of(_document(source, deployment), deployment, attached=attached)


def read_attaching(source: str | Path, deployment: Deployment) -> tuple[Attach, Terms, Document]:
    """`read_attach` and `read_terms` of a source, and the document that has its nodes, which is read once: by it errors
    about them are explained."""
    if _is_node(source, deployment):
        terms = read_terms(source, deployment, attached=True)
        return read_attach(source, deployment), terms, deployment.document
    document = _document(source, deployment)
    return attach_of(document), terms_of(document, deployment, attached=True), document


def read_replacing(source: str | Path, name: str, deployment: Deployment) -> tuple[Replace, Terms, Document]:
    """`read_replace` and `read_terms` of a source, and its document, as `read_attaching`."""
    document = _document(source, deployment)
    return replace_of(document, name), terms_of(document, deployment), document


def attach_of(document: Document) -> Attach:
    """What a snippet's document attaches. Raises `DeploymentError` if it is wrong."""
    model = _checked(document)
    nodes, edges = roster_nodes(model.nodes, document), roster_edges(model.edges or {}, document)
    return Attach(nodes, edges, turns_of(model.nodes, document))


def replace_of(document: Document, name: str) -> Replace:
    """What a snippet's document has in the place of the node of a name. Raises `DeploymentError` if it is wrong."""
    model = _checked(document)
    for given in model.nodes:
        if given != name:
            raise document.error(("nodes", given), f"expected no other node than the one to be replaced, {name!r}")
    edges = None if model.edges is None else roster_edges(model.edges, document)
    turns = turns_of(model.nodes, document).get(name)
    return Replace(name, roster_nodes(model.nodes, document)[name], edges, turns)


def terms_of(document: Document, deployment: Deployment, *, attached: bool = False) -> Mapping[str, ProcessTerms]:
    """What a snippet's document says of the processes of its nodes, as `read_terms` has it."""
    unsaid = _otherwise(deployment, attached)

    def otherwise(name: str) -> ProcessTerms:
        own = None if attached else deployment.terms.get(name)
        return unsaid if own is None else replace(unsaid, **{field: getattr(own, field) for field in _OF_THE_PLACE})

    roster = deployment.roster
    is_rated = roster.timing is not None
    return node_terms(_checked(document).nodes, otherwise, document, deployment.staleness, roster.world, is_rated)


def _otherwise(deployment: Deployment, attached: bool) -> ProcessTerms:
    """What holds of a node of which a snippet says nothing."""
    if attached and not _says(deployment, "restart") and deployment.roster.timing is None:
        return replace(deployment.restart, on_loss="detach")
    return deployment.restart


def _says(deployment: Deployment, *keys: str) -> bool:
    """Whether the deployment file says at this path what follows on a loss."""
    found = reduce(inside, keys, deployment.document.root)
    return isinstance(found, dict) and "on_loss" in found


def _is_node(source: str | Path, deployment: Deployment) -> bool:
    return str(source) in deployment.roster.nodes and not _is_file(source)


def _is_file(source: str | Path) -> bool:
    try:
        return Path(source).is_file()
    except (OSError, ValueError) as error:  # a name that no file can have
        raise DeploymentError(f"cannot be read: {error}", str(source)) from error


def _document(source: str | Path, deployment: Deployment) -> Document:
    if not _is_file(source):
        nearest = did_you_mean(str(source), deployment.roster.nodes, "its nodes are")
        what = f"there is no such file, and {deployment.path} has no node of that name{nearest}"
        raise DeploymentError(what, str(source))
    document = read_document(Path(source), "nodes and edges")
    document.outer = deployment.document
    return document


def _checked(document: Document) -> SnippetModel:
    root = substitute(document)
    try:
        model = SnippetModel.model_validate(root)
    except ValidationError as error:
        raise first_error(error, document, root, SnippetModel) from error
    if not model.nodes:
        raise document.error(("nodes",), "expected at least one node")
    check_gathers(model.edges or {}, document)
    for edge in model.edges or {}:
        if not model.nodes.keys() & set(split_edge(edge)):
            names = " or ".join(map(repr, sorted(model.nodes)))
            raise document.error(("edges", edge), f"joins two other nodes; expected an edge of {names}")
    return model


class Scheduled(NamedTuple):
    """A change that is known before the run, and takes effect at the start of an epoch."""

    epoch: int
    change: Change
    terms: Mapping[str, ProcessTerms] = {}  # of the processes of its new nodes
    document: Document | None = None  # that has them, by which errors about them are explained


def read_schedule(texts: Sequence[str], deployment: Deployment) -> tuple[Scheduled, ...]:
    """Changes, sorted by the epoch at whose start each takes effect; those of one epoch are made in the given order.
    The texts are as ``--at`` has them, see `FORMS`; ``FILE`` is a snippet, or in an attach the name of a node of the
    deployment file. Changes are tried on the deployment's roster, so that none is refused in the middle of a run.
    Raises `DeploymentError` if one is written wrongly, its snippet is wrong, or it cannot be made."""
    read = [(_scheduled(text, deployment), text) for text in texts]
    read.sort(key=lambda entry: entry[0].epoch)
    roster = deployment.roster
    for scheduled, text in read:
        roster = _after(scheduled.change, roster, deployment, f"--at {text}")
    return tuple(scheduled for scheduled, _ in read)


def _after(change: Change, roster: Roster, deployment: Deployment, place: str) -> Roster:
    try:
        deployment.allowance.check_all(change)
        return next_roster(roster, change)
    except (ChangeError, NotAllowedError) as error:
        raise DeploymentError(str(error), place) from error


def _scheduled(text: str, deployment: Deployment) -> Scheduled:
    place = f"--at {text}"
    number, _, rest = text.partition(":")
    kind, _, rest = rest.partition(":")
    kind = kind.strip()
    if kind not in FORMS:
        if not kind:
            raise DeploymentError(f"expected {', '.join(FORMS.values())}", place)
        raise DeploymentError(f"there is no change {kind!r}{did_you_mean(kind, FORMS)}", place)
    number = number.strip()
    if not number.isascii() or not number.isdigit() or len(number) > _DIGITS or int(number) == 0:
        raise DeploymentError(f"expected the number of an epoch, from 1, got {number!r:.40}", place)
    epoch = int(number)
    if kind == "attach" and rest:
        return Scheduled(epoch, *read_attaching(rest, deployment))
    name, colon, rest = rest.partition(":")
    if kind == "replace" and name and rest:
        return Scheduled(epoch, *read_replacing(rest, name, deployment))
    if kind == "detach" and name and (not colon or rest == "cascade"):
        return Scheduled(epoch, Detach(name, bool(colon)))
    raise DeploymentError(f"expected {FORMS[kind]}", place)
