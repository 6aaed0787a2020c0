"""``hierax validate``: whether a deployment file is right, as far as can be told without a run."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Annotated

from hierax.runtime.commands.options import File, Format, OutputFormat, Overrides, option
from hierax.runtime.commands.show import print_json

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment


def validate(
    file: File,
    overrides: Overrides = None,
    dry: Annotated[bool, option("--dry")] = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Check a deployment file: read it, import and make what it names, and see that that forms a hierarchy."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.execution.dry import run_dry
    from hierax.runtime.loading.loader import extend_import_path

    deployment = read_deployment(file, overrides or ())
    roster = deployment.roster
    extend_import_path(deployment.import_paths)
    with deployment.explaining(), redirect_stdout(sys.stderr):  # what a node prints must not mix with the result
        _check(deployment)
        calls = run_dry(deployment) if dry else 0
    content, nodes, edges = roster.content_hash().hex(), len(roster.nodes), len(roster.edges)
    if output_format is Format.json:
        result = {"hierarchy": deployment.name, "file": str(deployment.path), "nodes": nodes, "edges": edges}
        print_json({**result, "content": content, **({"dry_calls": calls} if dry else {})})
    else:
        called = f", {calls} dry calls" if dry else ""
        print(f"{deployment.path}: OK, {nodes} nodes, {edges} edges{called}, content {content}")
    return 0


def _check(deployment: Deployment) -> None:
    """All that can be told without calling more than the initial beliefs."""
    from hierax.runtime.core.binding import OperatorSetting
    from hierax.runtime.host.waiting import wait_for
    from hierax.runtime.loading.loader import LoadError, build_hierarchy, build_probe, check_initial_belief
    from hierax.runtime.loading.node_loader import misspelt_operators

    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(wait=wait_for), deployment.allowance)
    for name, node in hierarchy.nodes.items():
        for what in misspelt_operators(type(node)):
            raise LoadError(what, f"nodes.{name}.class")
        check_initial_belief(name, node)
    for index, probe in enumerate(deployment.probes):
        build_probe(probe.reference, f"probes[{index}]", deployment.allowance)
