"""Zenoh's settings as users give them: a map, JSON5, or the path of a file."""

from typing import TypeGuard


def names_file(settings: object) -> TypeGuard[str]:
    """Whether they are the path of a file."""
    return isinstance(settings, str) and not settings.lstrip().startswith("{")
