"""What a run writes into its output folder, and who writes what.

    roster.msgpack        the roster's content, encoded; the supervisor or `run`
    digests.msgpack       stream of [epoch, digest]; the world's process
    states/NAME.msgpack   stream of [epoch, attempt, state, digest]; each node's process
    summary.json          the report; the command

and whatever the deployment's probes write.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hierax.runtime.allowance import Allowance
from hierax.runtime.core.errors import ProbeError
from hierax.runtime.core.probe import Probe
from hierax.runtime.loading import build_probe
from hierax.runtime.runner import Log
from hierax.schemas.roster import ProbeSpec, Roster
from hierax.schemas.values import encode_value

ROSTER = "roster.msgpack"
DIGESTS = "digests.msgpack"
STATES = "states"


def write_roster(output: Path, roster: Roster) -> None:
    """Write the content that the digests cover."""
    output.mkdir(parents=True, exist_ok=True)
    (output / ROSTER).write_bytes(encode_value(roster.content()))


def state_log(output: Path | None, name: str, append: bool = False) -> Log | None:
    """Where a node's states go; behind what is there, for a process that comes in the place of another."""
    return None if output is None else Log(output / STATES / f"{name}.msgpack", append)


def open_probes(
    specs: Sequence[ProbeSpec], name: str, allowance: Allowance, output: Path | None, again: bool = False
) -> tuple[Probe, ...]:
    """The probes of a node, open.

    Args:
        specs: of all nodes.
        name: of the node.
        allowance: which code may be loaded.
        output: the run's output folder.
        again: another process of the node has had them open before in this run.

    Raises:
        NotAllowedError, LoadError: one may not be loaded, or cannot be built.
        ProbeError: one cannot be opened.
    """
    own = [(i, spec.reference) for i, spec in enumerate(specs) if spec.node == name]
    probes = tuple(build_probe(reference, f"probes[{i}]", allowance) for i, reference in own)
    for probe in probes:
        _open(probe, name, output, again)
    return probes


def _open(probe: Probe, name: str, output: Path | None, again: bool) -> None:
    try:
        if again:
            probe.open_again(output)
        else:
            probe.open(output)
    except Exception as error:
        raise ProbeError(name, probe, "open", error) from error
