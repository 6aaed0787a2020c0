"""The deployment of a recording, and others in its place."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.secrets import usable
from hierax.runtime.host.seal import NOT_OURS
from hierax.runtime.loading.allowance import ANYTHING, Allowance
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.info import RecordingError, RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Rewrite
from hierax.schemas.roster import Reference, Roster


def recorded_deployment(info: RunInfo, settings: Sequence[str] = ()) -> Deployment:
    """The deployment as it was recorded, whether or not its file is still there, with further settings (``--set``).

    Raises `DeploymentError` if a setting is wrong.
    """
    with tempfile.TemporaryDirectory(prefix="hierax-") as folder:
        path = Path(folder) / (Path(info.deployment).name or "deployment")
        try:
            path.write_text(info.deployment_text, encoding="utf-8")
        except OSError as error:  # a name that no file can have
            raise RecordingError(f"its deployment file cannot be written: {error.strerror or error}") from error
        # a file that the deployment names beside it is not here, and not needed
        deployment = read_deployment(path, ["zenoh=null", *usable(info.settings), *settings])
    return replace(deployment, path=Path(info.deployment), import_paths=tuple(info.import_paths))


def allowance_of(recording: Recording, trust: bool = False) -> Allowance:
    """Which code may be loaded to do a recording again; all that it names, whoever has written it, where it is trusted.

    Raises `RecordingError` if it is not known to be this user's own, and not trusted.
    """
    if trust:
        return ANYTHING
    if not recording.info.is_ours:
        raise RecordingError(f"{recording.path}: {NOT_OURS}")
    return Allowance(tuple(recording.info.modules))


def other_settings(info: RunInfo, settings: Sequence[str], classes: Mapping[str, str]) -> Rewrite | None:
    """What replays a recording with other parameters or classes; None where none are given.

    Args:
        info: of the recording.
        settings: as ``--set`` has them, of the deployment file; `DeploymentError` is raised if one is wrong.
        classes: ``package.module:Class`` by node.
    """
    if not settings and not classes:
        return None
    rewrite = rewriting(recorded_deployment(info).roster, recorded_deployment(info, settings).roster)

    def rewritten(roster: Roster) -> Roster:
        roster = rewrite(roster)
        others = {
            name: Reference(classes[name], roster.nodes[name].parameters) for name in roster.nodes if name in classes
        }
        return replace(roster, nodes={**roster.nodes, **others})

    return rewritten


def in_place_of(recorded: Roster, deployment: Deployment) -> Rewrite:
    """What replays a recording, whose first roster is given, with a deployment in the place of its own."""
    content, other = recorded.content(), deployment.roster
    rewrite = rewriting(recorded, other)

    def rewritten(roster: Roster) -> Roster:
        if roster.content() == content:
            return replace(other, version=roster.version, instances=roster.instances)
        return rewrite(roster)  # it was changed since

    return rewritten


def rewriting(old: Roster, new: Roster) -> Rewrite:
    """What puts new classes, parameters and edge functions in the place of old ones, wherever these are.

    Args:
        old, new: two rosters of one deployment file, read with other settings.
    """
    nodes = {name: (old.nodes[name], new.nodes[name]) for name in old.nodes.keys() & new.nodes.keys()}
    new_edges = {edge.pair: edge for edge in new.edges}
    edges = {edge.pair: (edge, new_edges[edge.pair]) for edge in old.edges if edge.pair in new_edges}

    def rewrite(roster: Roster) -> Roster:
        changed: Mapping[str, Reference] = {
            name: nodes[name][1] if name in nodes and nodes[name][0] == reference else reference
            for name, reference in roster.nodes.items()
        }
        joined = tuple(edges[e.pair][1] if e.pair in edges and edges[e.pair][0] == e else e for e in roster.edges)
        return Roster(roster.world, changed, joined, roster.version, roster.instances)

    return rewrite


def check_names(recording: Recording, names: Iterable[str]) -> None:
    """See that a recording has nodes of these names; `RecordingError` says which one is nearest to one that lacks."""
    known = {name for roster in recording.rosters().values() for name in roster.nodes}
    for name in names:
        if name not in known:
            nearest = did_you_mean(name, known, "the nodes are")
            raise RecordingError(f"{recording.path}: there is no node {name!r}{nearest}")
