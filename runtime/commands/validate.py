"""``hierax validate``: whether a deployment file is right, as far as can be told without a run."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Any

from hierax.runtime.commands.options import File, Format, OutputFormat, Settings


def validate(file: File, settings: Settings = None, output_format: OutputFormat = Format.text) -> int:
    """Check a deployment file: read it, import and make what it names, and see that that forms a hierarchy."""
    from hierax.runtime.commands.show import print_json
    from hierax.runtime.core.binding import Setting
    from hierax.runtime.core.errors import HieraxError
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.loading import build_hierarchy, build_probe, check_initial_belief, extend_import_path

    deployment = read_deployment(file, settings or ())
    roster = deployment.roster
    extend_import_path(deployment.import_paths)
    try:
        hierarchy = build_hierarchy(roster, Setting(wait=_wait), deployment.allowance)
        for name, node in hierarchy.nodes.items():
            check_initial_belief(name, node)
        for index, probe in enumerate(deployment.probes):
            build_probe(probe.reference, f"probes[{index}]", deployment.allowance)
    except HieraxError as error:
        raise deployment.explain(error) from error
    content = roster.content_hash().hex()
    if output_format is Format.json:
        result = {"hierarchy": deployment.name, "file": str(deployment.path)}
        print_json({**result, "nodes": len(roster.nodes), "edges": len(roster.edges), "content": content})
    else:
        print(f"{deployment.path}: OK, {len(roster.nodes)} nodes, {len(roster.edges)} edges, content {content}")
    return 0


def _wait(awaitable: Awaitable[Any]) -> Any:
    import anyio

    async def wait() -> Any:
        return await awaitable

    return anyio.run(wait)
