"""All nodes in one process: the deterministic mode, in virtual time, without event loop or threads."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import anyio

from hierax.runtime.core.binding import Setting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.deployment import Deployment
from hierax.runtime.engine.engine import DigestChain, Engine, Place
from hierax.runtime.files import DIGESTS, open_probes, state_log, write_roster
from hierax.runtime.loading import build_hierarchy
from hierax.runtime.report import Report, make_report
from hierax.runtime.runner import Log, NodeRunner, Pacemaker
from hierax.runtime.transport.memory import MemoryNetwork


def run(
    deployment: Deployment,
    *,
    epochs: int | None,
    seed: int,
    output: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> Report:
    """Run a deployment in this process.

    Args:
        deployment: what to run.
        epochs: how many; None: the deployment's number, or until the world has finished.
        seed: of all random numbers, and of the order in which messages are delivered.
        output: folder for the states, digests and what probes write; None: nothing is written.
        progress: told the number of each epoch that is committed.

    Raises:
        HieraxError: a node cannot be loaded or failed.
    """
    hierarchy = build_hierarchy(deployment.roster, Setting(seed, _wait))
    network = MemoryNetwork(seed)
    digests = None if output is None else Log(output / DIGESTS)

    def on_commit(epoch: int, digest: bytes) -> None:
        if digests is not None:
            digests.write(epoch, digest)
        if progress is not None:
            progress(epoch)

    limit = deployment.epochs if epochs is None else epochs
    chain = DigestChain(deployment.roster.content_hash())
    pacemaker = Pacemaker(chain, limit, on_commit)
    if output is not None:
        write_roster(output, deployment.roster)
    runners = _runners(deployment, hierarchy, network, pacemaker, output)
    try:
        _deliver_all(runners, hierarchy.world, network)
    finally:
        for runner in runners.values():
            runner.close()
        if digests is not None:
            digests.close()
    nodes = {name: runner.report() for name, runner in runners.items()}
    return make_report(
        deployment.name,
        "run",
        seed,
        chain.epoch,
        chain.digest,
        pacemaker.wall_s,
        pacemaker.epochs_s,
        nodes,
        output,
    )


def _runners(
    deployment: Deployment,
    hierarchy: Hierarchy,
    network: MemoryNetwork,
    pacemaker: Pacemaker,
    output: Path | None,
) -> Mapping[str, NodeRunner]:
    roster = deployment.roster
    place = Place.of(roster)
    edges = tuple(hierarchy.bound_edges.values())
    return {
        name: NodeRunner(
            Engine(bound, edges, place),
            network.open_port(name),
            open_probes(deployment.probes, name, output),
            state_log(output, name),
            pacemaker if name == hierarchy.world else None,
        )
        for name, bound in hierarchy.bound.items()
    }


def _deliver_all(runners: Mapping[str, NodeRunner], world: str, network: MemoryNetwork) -> None:
    runners[world].start()
    while (name := network.next_receiver()) is not None:
        message = runners[name].port.receive()
        if message is not None:
            runners[name].step(message)
    waiting = {name: runner.engine.waits_for for name, runner in runners.items()}
    if runners[world].engine.waits_for:
        raise HieraxError(f"nothing is under way any more, but nodes wait: {waiting}")


def _wait(awaitable: Awaitable[Any]) -> Any:
    async def wait() -> Any:
        return await awaitable

    return anyio.run(wait)
