"""A Python environment as a reader of the documentation has it: it sees the distributions that were asked for."""

from __future__ import annotations

import re
import sys
import venv
from collections.abc import Iterable
from importlib.metadata import Distribution
from pathlib import Path

_INSTALLED = [path for path in sys.path if path.endswith("-packages")]
_NAME = re.compile(r"([A-Za-z0-9._-]+)(?:\[([^]]*)\])?")
_EXTRA = re.compile(r"""extra\s*==\s*["']([^"']+)["']""")


def environment_of(requirements: Iterable[str], folder: Path) -> Path:
    """Make one, of what is installed here.

    Args:
        requirements: such as ``hierax[record]``.
        folder: where it is made.

    Returns:
        Its folder of programs.
    """
    venv.create(folder, symlinks=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = folder / "lib" / version / "site-packages"
    programs = folder / "bin"
    for each in _closure(requirements).values():
        _link(each, packages)
        for script in each.entry_points.select(group="console_scripts"):
            call = f"from {script.module} import {script.attr} as main; sys.exit(main())"
            (programs / script.name).write_text(f"#!{programs / 'python'}\nimport sys; {call}\n")
            (programs / script.name).chmod(0o755)
    return programs


def _closure(requirements: Iterable[str]) -> dict[str, Distribution]:
    """The distributions that are asked for, and those that they need."""
    found: dict[str, Distribution] = {}
    waiting = [(requirement, "") for requirement in requirements]
    seen: set[tuple[str, str]] = set()
    while waiting:
        text, _ = waiting.pop()
        match = _NAME.match(text.strip())
        assert match is not None, text
        name, extras = match[1], {extra.strip() for extra in (match[2] or "").split(",") if extra.strip()}
        for extra in ("", *sorted(extras)):
            if (name.lower(), extra) in seen:
                continue
            seen.add((name.lower(), extra))
            installed = Distribution.discover(name=name, path=_INSTALLED)
            each = next(iter(installed), None)
            if each is None:
                continue  # of another system or version of Python
            found[each.metadata["Name"]] = each
            for needed in each.requires or ():
                marked = _EXTRA.search(needed)
                if (marked[1] if marked else "") == extra:
                    waiting.append((needed, extra))
    return found


def _link(each: Distribution, packages: Path) -> None:
    """Have its packages and modules stand in another folder, too."""
    for top in sorted({Path(path).parts[0] for path in map(str, each.files or ())} - {"..", "__pycache__"}):
        source, target = Path(str(each.locate_file(top))), packages / top
        if source.exists() and not target.exists():
            target.symlink_to(source)
