"""A deployment: what a deployment file says, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.document import Document
from hierax.schemas.roster import ProbeSpec, Roster
from hierax.schemas.values import Value


@dataclass(frozen=True)
class Deployment:
    """What a deployment file says, after ``--set``.

    Attributes:
        path: the file.
        name: of the hierarchy.
        description: in one line; may be empty.
        epochs: how many by default; None: until the world says finished.
        roster: nodes and edges.
        probes: in the file's order; where errors name one, it is ``probes[i]``.
        start_timeout_s: how long all nodes may take to come up, in seconds.
        zenoh: Zenoh's own settings: a map, JSON5 text in braces, or the path of a file; None
            where none are given.
        import_paths: folders in which the deployment's own modules are looked for.
        document: where everything stands in the file.
    """

    path: Path
    name: str
    description: str
    epochs: int | None
    roster: Roster
    probes: tuple[ProbeSpec, ...]
    start_timeout_s: float
    zenoh: Mapping[str, Value] | str | None
    import_paths: tuple[str, ...]
    document: Document = field(repr=False, compare=False)

    def place(self, where: str) -> str:
        """``file:line`` of a path such as ``nodes.world.class``, or the ``--set`` that gave it."""
        return self.document.where(self.document.keys(where))

    def explain(self, error: HieraxError) -> HieraxError:
        """An error with its place in the deployment file, where it has one.

        Args:
            error: if it has a `where`, as a `LoadError` has, that is a path in the roster.
        """
        where = getattr(error, "where", "")
        if not where:
            return error
        return self.document.error(self.document.keys(where), str(error).removeprefix(f"{where}: "))
