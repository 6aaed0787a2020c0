"""``hierax inspect``: what a node of a launch believes, and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hierax.runtime.commands.options import Format, OutputFormat
from hierax.runtime.commands.which import Connect, NodeArgument, Run, client_of

if TYPE_CHECKING:
    from hierax.runtime.execution.plain import Json
    from hierax.runtime.transport.launch_client import Answer, LaunchStatus


def inspect(
    node: NodeArgument,
    run: Run = None,
    connect: Connect = None,
    full: Annotated[bool, typer.Option("--full", help="In JSON, arrays with all their elements.")] = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Show what a node has observed, believes, was told from above and does, after its last epoch."""
    from hierax.runtime.commands.show import print_json

    with client_of(run, connect) as client:
        status = client.status()
        answer = client.node_state(status, node)
    if output_format is Format.json:
        print_json(as_json(status, node, answer, full))
    else:
        _print(status, node, answer)
    return 0


def as_json(status: LaunchStatus, node: str, answer: Answer, full: bool = False) -> Json:
    """All of it as plain JSON."""
    from hierax.runtime.execution.plain import plain

    told = {key: value for key, value in answer.items() if key != "process"}
    return {
        "hierarchy": status.hierarchy,
        "run": status.run,
        "node": node,
        **{key: plain(value, full) for key, value in told.items()},
    }


def _print(status: LaunchStatus, node: str, answer: Mapping[str, Any]) -> None:
    from hierax.runtime.tools.summary import tree

    counts = {True: "committed", False: "not committed yet", None: "epochs overlap"}[answer["committed"]]
    print(f"{node} of {status.hierarchy}, run {status.run}: after epoch {answer['epoch']} ({counts})")
    print(f"class  {answer['class']}")
    for where in ("below", "above"):
        print(f"{where}  {', '.join(answer[where]) or 'nothing'}")
    print(f"policy  {answer['policy']} (of {', '.join(answer['policies'])})")
    for what in ("observations", "sensed", "tasks", "context", "actions", "belief"):
        if what in answer:
            print("\n".join(tree(answer[what], what)))
