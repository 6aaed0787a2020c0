"""``hierax new``: a project of one's own."""

import importlib.util
import keyword
import re
import sys
from importlib.resources import files
from pathlib import Path
from typing import Annotated

from hierax.runtime.commands.options import Format, OutputFormat, argument
from hierax.runtime.commands.show import print_json
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import errors_named
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import check_name

_TEMPLATES = {
    "README.md": "README.md.txt",
    "@NAME@.yaml": "deployment.yaml.txt",
    "@MODULE@.py": "module.py.txt",
    "test_@MODULE@.py": "test_module.py.txt",
    "pytest.ini": "pytest.ini.txt",
}


def make_project(folder: Path) -> list[Path]:
    """Write a project into a folder that is not there yet, or empty. `folder`: its last part is the project's name.
    Returns the files, in order. Raises `HieraxError` if the name cannot be one, there is something already, or it
    cannot be written."""
    name = folder.resolve().name
    module = re.sub(r"[^a-z0-9_]", "_", name.lower())
    _check_name(name, module)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise HieraxError(f"{folder} is there already, and nothing is overwritten; give another name")
    made: list[Path] = []
    with errors_named(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for target, template in _TEMPLATES.items():
            path = folder / _filled(target, name, module)
            text = (files("hierax.runtime.tools") / "template" / template).read_text(encoding="utf-8")
            with path.open("x", encoding="utf-8") as file:
                file.write(_filled(text, name, module))
            made.append(path)
    return made


def _check_name(name: str, module: str) -> None:
    try:
        check_name(name, "project's name")
    except SchemaError as error:
        raise HieraxError(str(error)) from error
    if not module.isidentifier() or keyword.iskeyword(module):
        raise HieraxError(f"{name!r} gives no name of a Python module; begin it with a letter")
    if module in sys.stdlib_module_names or importlib.util.find_spec(module) is not None:
        raise HieraxError(f"{name!r}: there is a Python module {module!r} already; give another name")


def _filled(text: str, name: str, module: str) -> str:
    return text.replace("@NAME@", name).replace("@MODULE@", module)


def new(
    name: Annotated[Path, argument("NAME", "The project's name, or the path of its folder.")],
    output_format: OutputFormat = Format.text,
) -> int:
    """Begin a project: a folder with a node, a deployment file that runs at once, and tests. Overwrites nothing."""
    made = make_project(name)
    steps = [f"cd {name}", f"hierax run {name.resolve().name}.yaml", "pytest"]
    if output_format is Format.json:
        print_json({"folder": str(name), "files": [str(path) for path in made], "next": steps})
    else:
        print("\n".join([*(f"made {path}" for path in made), "\nnow:", *(f"  {step}" for step in steps)]))
    return 0
