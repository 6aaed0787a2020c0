"""Rows that benchmarks of the tower deployment keep in a file, so that hours of them go on where they were ended."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

ROOT = Path(__file__).resolve().parents[1]
OF_NODES, OF_NO_NODE = ("picking", "tower", "tracking"), {"evaluation", "generator"}  # folders

R = TypeVar("R")


class Kept(Generic[R]):
    """Rows of a file, one JSON object a line, to which new ones are added; of no file there are none.

    A row belongs to the sources of the nodes that it was made by; those of others are left alone. Raises `SystemExit`
    where the file has something else in it, or cannot be written.

    Args:
        path: of the file.
        of: the rows' class, a dataclass.
        key: what a row belongs to.
    """

    def __init__(self, path: Path | None, of: Callable[..., R], key: Callable[[R], str]) -> None:
        self._path, self._sources = path, sources()
        self._rows: dict[str, R] = {}
        if path is None:
            return
        try:
            with path.open("a+") as file:
                file.seek(0)
                lines = file.readlines()
        except (OSError, UnicodeDecodeError) as error:
            raise SystemExit(f"--keep {path}: it cannot be read and written: {error}") from error
        for number, line in enumerate(lines, start=1):
            try:
                if not line.endswith("\n"):
                    raise ValueError("it is cut off")
                content = json.loads(line)
                made_by, row = content.pop("sources"), of(**content)
            except (ValueError, TypeError, KeyError, AttributeError) as error:
                what = "expected a row that this program has written"
                raise SystemExit(f"--keep {path}: line {number}: {what}: {error}") from error
            if made_by == self._sources:
                self._rows[key(row)] = row

    def row(self, key: str, make: Callable[[], R]) -> R:
        """What a scene came to: as it is kept, or by running it."""
        if key not in self._rows:
            made: Any = make()
            self._rows[key] = made
            if self._path is not None:
                with self._path.open("a") as file:
                    file.write(json.dumps({**asdict(made), "sources": self._sources}) + "\n")
        return self._rows[key]


def sources() -> str:
    """A digest of the deployment and of what its nodes are made of: figures of others are not those of these."""
    nodes = [file for folder in OF_NODES for file in sorted((ROOT / "nodes" / folder).rglob("*.py"))]
    files = [*(file for file in nodes if not OF_NO_NODE.intersection(file.parts)), ROOT / "deploy" / "tower.yaml"]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
