"""The names by which processes find what a script gives as objects: ``module:name`` of classes and functions."""

import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hierax.runtime.core.errors import HierarchyError

Code = Callable[..., Any]
"""A class or function; with parameters, as `functools.partial` of it with keyword arguments."""

_MAIN = "__main__"


def named(code: Code, what: str) -> tuple[str, dict[str, Any]]:
    """The target of a class or function, and its parameters as a deployment file would have them.

    Raises `HierarchyError`, which begins with `what`, if it is none, has no name at the top of a module, or a parameter
    cannot stand in a file."""
    parameters: dict[str, Any] = {}
    while isinstance(code, partial):
        if code.args:
            raise HierarchyError(f"{what}: give parameters by name: partial({_shown(code.func)}, name=value)")
        parameters, code = {**code.keywords, **parameters}, code.func
    module, name = getattr(code, "__module__", None), getattr(code, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str):
        raise HierarchyError(f"{what}: expected a class, a function, or functools.partial of one, got {code!r:.80}")
    home = sys.modules.get(module)
    if "." in name or getattr(home, name, None) is not code:
        raise HierarchyError(f"{what}: {module}.{name} cannot be found by its name; define it at the top of a module")
    return f"{_module_name(module)}:{name}", {key: _plain(value, f"{what}: {key}") for key, value in parameters.items()}


def script_folders() -> list[str]:
    """The folders in which other processes have to look, too: those of this script's path, but for Python's own."""
    own = {Path(prefix).resolve() for prefix in (sys.prefix, sys.base_prefix)}
    folders = [Path(folder).resolve() for folder in sys.path if Path(folder).is_dir()]
    return [str(folder) for folder in folders if not own & {folder, *folder.parents}]


def script_modules() -> set[str]:
    """The names of the module that runs as a script, or notebook."""
    return {_MAIN, _module_name(_MAIN)}


def _module_name(module: str) -> str:
    """A module as other processes know it; a script's is known by that name here, too, and not run a second time."""
    if module != _MAIN:
        return module
    main = sys.modules[_MAIN]
    spec = getattr(main, "__spec__", None)
    file = getattr(main, "__file__", None)
    script = Path(file) if file is not None and Path(file).suffix == ".py" else None  # others nothing can import
    name = spec.name if spec is not None else _MAIN if script is None else script.stem
    if not all(part.isidentifier() for part in name.split(".")):
        return _MAIN  # likewise
    if sys.modules.setdefault(name, main) is not main:
        raise HierarchyError(f"the script {file} is named like module {name!r}, which is loaded: give it another name")
    return str(name)


def _plain(value: Any, what: str) -> Any:
    """A parameter as YAML has it: arrays and tuples as lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [_plain(item, what) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{what}.{key}") for key, item in value.items()}
    if isinstance(value, str):
        return value.replace("${", "$${")
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, (int, float)):  # an enumeration's, too
        return int(value) if isinstance(value, int) else float(value)
    raise HierarchyError(f"{what}: expected text, numbers, lists, maps or arrays, got a {type(value).__name__}")


def _shown(code: Any) -> str:
    return str(getattr(code, "__name__", repr(code)))
