"""The one error that reading a message can raise."""

from typing import Any

SHOWN_CHARS = 40


class SchemaError(ValueError):
    """Bytes or a value do not fit the wire format; `what` says what is wrong, and what was expected, `where` the field
    or path at which it shows, e.g. ``payload[0].pose``."""

    def __init__(self, what: str, where: str = "") -> None:
        self.what = what
        self.where = where
        super().__init__(f"{where}: {what}" if where else what)


def shown(value: Any) -> str:
    """A value of foreign make for an error's text: short, whatever its size."""
    if isinstance(value, (str, bytes)):
        return repr(value[:SHOWN_CHARS]) + ("…" if len(value) > SHOWN_CHARS else "")
    if value is None or isinstance(value, (bool, int, float)):
        return repr(value)
    return f"a {type(value).__name__}"
