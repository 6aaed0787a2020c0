"""What a run writes into its output folder, and who writes what.

    roster.msgpack        the roster's content, encoded; the supervisor or `run`
    digests.msgpack       stream of [epoch, digest]; the world's process
    states/NAME.msgpack   stream of [epoch, attempt, state, digest]; each node's process
    summary.json          the report; the command

and whatever the deployment's probes write.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hierax.runtime.core.errors import HieraxError, ProbeError
from hierax.runtime.core.probe import Probe
from hierax.runtime.execution.log import Log
from hierax.runtime.host.private_files import HeldError, errors_named, hold, open_result, write_result
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_probe
from hierax.schemas.roster import ProbeSpec, Roster
from hierax.schemas.values import encode_value

ROSTER = "roster.msgpack"
DIGESTS = "digests.msgpack"
STATES = "states"
SUMMARY = "summary.json"


class OutputError(HieraxError):
    """An output folder cannot be used; says why."""


@contextmanager
def claimed_output(output: Path, overwrite: bool = False, goes_on: bool = False) -> Iterator[None]:
    """Have an output folder for this run alone.

    Args:
        output: the folder; made where it lacks.
        overwrite: whether what another run has left there is removed: what this module writes, and nothing else.
        goes_on: whether the run that is there is resumed.

    Raises:
        OutputError: it cannot be made or written, another process writes there, or there is a run in it.
    """
    roster = output / ROSTER
    try:
        output.mkdir(parents=True, exist_ok=True)
        file = open_result(roster)
    except OSError as error:
        raise OutputError(f"--output {output}: it cannot be made or written: {error.strerror or error}") from error
    try:
        hold(file, lambda holder: HeldError(f"--output {output}: {holder} is writing there; name another folder"))
        there = _of_a_run(output)
        if there and not (overwrite or goes_on):
            what = f"there is a run in it already ({there[0].relative_to(output)})"
            raise OutputError(f"--output {output}: {what}; --overwrite replaces it, or name another folder")
        for path in there if overwrite and not goes_on else ():
            if path != roster:  # which is held
                path.unlink()
        yield
    finally:
        if not os.fstat(file).st_size:
            roster.unlink(missing_ok=True)
        os.close(file)


def _of_a_run(output: Path) -> list[Path]:
    """What a run has written."""
    named = [output / name for name in (ROSTER, DIGESTS, SUMMARY)]
    found = [path for path in named if path.is_file() and path.stat().st_size]
    return found + sorted((output / STATES).glob("*.msgpack"))


def write_roster(output: Path, roster: Roster) -> None:
    """Write the content that the digests cover. Raises `HieraxError` if it cannot be written."""
    with errors_named(output / ROSTER, kind=OutputError):
        output.mkdir(parents=True, exist_ok=True)
        write_result(output / ROSTER, encode_value(roster.content()))


def state_log(output: Path | None, name: str, append: bool = False) -> Log | None:
    """Where a node's states go; behind what is there, for a process that comes in the place of another."""
    return None if output is None else Log(output / STATES / f"{name}.msgpack", append)


def digest_log(output: Path | None, append: bool = False) -> Log | None:
    """Where a run's digests go; behind what is there, where the world's process is not the first one."""
    return None if output is None else Log(output / DIGESTS, append)


def open_probes(
    specs: Sequence[ProbeSpec], name: str, allowance: Allowance, output: Path | None, again: bool = False
) -> tuple[Probe, ...]:
    """The probes of a node, open; `again`: another process of the node has had them open before in this run.

    Raises `NotAllowedError`, `LoadError` or `ProbeError` if one may not be loaded, cannot be built, or not be opened.
    """
    own = [(i, spec) for i, spec in enumerate(specs) if spec.node == name]
    probes = tuple(build_probe(spec.reference, f"probes[{i}]", allowance) for i, spec in own)
    for probe, (_, spec) in zip(probes, own, strict=True):
        probe.overwrite = spec.overwrite
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
