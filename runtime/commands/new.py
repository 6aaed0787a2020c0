"""``hierax new``: a project of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from hierax.runtime.commands.options import Format, OutputFormat, argument
from hierax.runtime.commands.show import print_json


def new(
    name: Annotated[Path, argument("NAME", "The project's name, or the path of its folder.")],
    output_format: OutputFormat = Format.text,
) -> int:
    """Begin a project: a folder with a node, a deployment file that runs at once, and tests. Overwrites nothing."""
    from hierax.runtime.tools.project import make_project

    made = make_project(name)
    steps = [f"cd {name}", f"hierax run {name.resolve().name}.yaml", "pytest"]
    if output_format is Format.json:
        print_json({"folder": str(name), "files": [str(path) for path in made], "next": steps})
        return 0
    print("\n".join([*(f"made {path}" for path in made), "\nnow:", *(f"  {step}" for step in steps)]))
    return 0
