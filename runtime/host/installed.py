"""Which hierax is installed here: its version, and a digest of its files."""

import hashlib
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

_PACKAGES = ("schemas", "runtime", "nodes")  # what runs on other hosts
_FRONT = "front"  # which stands elsewhere when it is installed


@cache
def installed_version() -> str:
    return version("hierax")


@cache
def installed_digest() -> str:
    """Of all modules, by name and content; the same for an installed hierax and for one that is worked on."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        spec = find_spec(f"hierax.{package}")
        places = None if spec is None else spec.submodule_search_locations
        root = Path(next(iter(places or ())))
        for path in sorted(root.rglob("*.py")):
            name = path.relative_to(root)
            if name.parts[0] != _FRONT:
                content = path.read_bytes()
                digest.update(f"{package}/{name.as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]
