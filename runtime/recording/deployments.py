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
    """The deployment as it was recorded, with further settings; `DeploymentError` if one of these is wrong."""
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
    """Which code may be loaded to do a recording again that is ours, or trusted; `RecordingError` if it is neither."""
    if trust:
        return ANYTHING
    if not recording.info.is_ours:
        raise RecordingError(f"{recording.path}: {NOT_OURS}")
    return Allowance(tuple(recording.info.modules))


def other_settings(info: RunInfo, settings: Sequence[str], classes: Mapping[str, str]) -> Rewrite | None:
    """What replays a recording with other parameters (``--set``), or classes by node; None where none are given."""
    if not settings and not classes:
        return None
    rewrite = rewriting(recorded_deployment(info).roster, recorded_deployment(info, settings).roster)

    def rewritten(roster: Roster) -> Roster:
        roster = rewrite(roster)
        known = [name for name in classes if name in roster.nodes]
        others = {name: Reference(classes[name], roster.nodes[name].parameters) for name in known}
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
    """What puts a new roster's classes, parameters and edge functions in an old one's place, wherever these are."""
    old_edges, new_edges = ({edge.pair: edge for edge in each.edges} for each in (old, new))

    def rewrite(roster: Roster) -> Roster:
        nodes = {
            name: new.nodes.get(name, reference) if old.nodes.get(name) == reference else reference
            for name, reference in roster.nodes.items()
        }
        edges = [new_edges.get(e.pair, e) if old_edges.get(e.pair) == e else e for e in roster.edges]
        return replace(roster, nodes=nodes, edges=tuple(edges))

    return rewrite


def check_names(recording: Recording, names: Iterable[str]) -> None:
    """See that a recording has nodes of these names; `RecordingError` says which one is nearest to one that lacks."""
    known = {name for roster in recording.rosters().values() for name in roster.nodes}
    for name in names:
        if name not in known:
            nearest = did_you_mean(name, known, "the nodes are")
            raise RecordingError(f"{recording.path}: there is no node {name!r}{nearest}")
