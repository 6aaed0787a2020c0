"""``hierax set``: parameters of a node of a launch that runs."""

from typing import Annotated, Any

from hierax.runtime.commands.errors import UsageError
from hierax.runtime.commands.membership import ask_for, print_epoch
from hierax.runtime.commands.options import RunOptions, argument, offers
from hierax.runtime.commands.which_launch import client_at, launch_meant


@offers("run", "connect", "key", "output_format")
def set(
    texts: Annotated[list[str], argument("NODE.PARAMETER=VALUE…", "Parameters of one node, values as YAML has them.")],
    options: RunOptions,
) -> int:
    """Change parameters of a node of a hierarchy that runs, which keeps its belief, and print the epoch."""
    from hierax.schemas.roster import Reference, Replace

    given = [_parameter(text) for text in texts]
    (node, *others) = dict.fromkeys(name for name, _, _ in given)
    if others:
        raise UsageError(f"expected parameters of one node, got some of {node} and {', '.join(others)}")
    names = [name for _, name, _ in given]
    if len({*names}) < len(names):
        raise UsageError(f"expected each parameter once, got {', '.join(names)}")
    launch = launch_meant(options.run, options.connect, options.key)
    with client_at(launch) as client:
        status = client.status()
        status.check_node(node)
        was = client.roster(status).nodes[node]
    changed = Reference(was.target, {**was.parameters, **{name: value for _, name, value in given}})
    what = ", ".join(f"{name} = {value!r}" for _, name, value in given)
    answer = ask_for(launch, Replace(node, changed), {})  # without terms: its process is kept as it is now
    return print_epoch(answer, f"{node}: {what}", options.output_format)


def _parameter(text: str) -> tuple[str, str, Any]:
    """Node, parameter and value of ``NODE.PARAMETER=VALUE``. Raises `UsageError` if it is written otherwise."""
    from hierax.runtime.deployment.tree import read_tree
    from hierax.schemas.values import decode_value, encode_value

    path, equals, value = text.partition("=")
    node, dot, name = path.rpartition(".")
    if not (equals and dot and node.strip() and name.strip()):
        raise UsageError(f"expected NODE.PARAMETER=VALUE, got {text!r}")
    return node.strip(), name.strip(), decode_value(encode_value(read_tree(value, text, has_lines=False).value))
