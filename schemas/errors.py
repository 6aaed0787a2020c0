"""The one error that reading a message can raise."""

from __future__ import annotations


class SchemaError(ValueError):
    """Bytes or a value do not fit the wire format.

    Args:
        what: what is wrong, and what was expected.
        where: the field or path at which it shows, e.g. ``payload[0].pose``.
    """

    def __init__(self, what: str, where: str = "") -> None:
        self.what = what
        self.where = where
        super().__init__(f"{where}: {what}" if where else what)
