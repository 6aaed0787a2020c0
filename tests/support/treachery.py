"""What nobody may have called: it is no node and no edge function, and leaves a file where it is made."""

from __future__ import annotations

from pathlib import Path


class Writer:
    """Overwrites a file.

    Args:
        path: of the file.
    """

    def __init__(self, path: str) -> None:
        Path(path).write_text("overwritten", encoding="utf-8")


def overwrite(path: str) -> Writer:
    """The same as a function."""
    return Writer(path)
