"""What is wrong with the data that a tracking deployment reads."""

from __future__ import annotations

from hierax.runtime.core.errors import HieraxError


class DataError(HieraxError):
    """A file of a scene or a model is missing or damaged; the message names it and what was expected."""
