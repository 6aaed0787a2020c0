"""The one error of a deployment file."""

from __future__ import annotations

from hierax.runtime.core.errors import HieraxError


class DeploymentError(HieraxError):
    """A deployment file, or a ``--set``, is wrong: where, which field, and what was expected.

    Attributes:
        place: ``file:line``, the file alone, or the ``--set`` as it was given.
        field: the path of the field, e.g. ``nodes.world.parameters.noise``; may be empty.
        what: what is wrong, what was expected, and the nearest valid name.
    """

    def __init__(self, what: str, place: str, field: str = "") -> None:
        self.what = what
        self.place = place
        self.field = field
        super().__init__(": ".join(part for part in (place, field, what) if part))
