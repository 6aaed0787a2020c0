"""A deployment file as read: its values, and where each one comes from."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, field
from typing import Any

from hierax.runtime.deployment.paths import DeploymentError, Keys, field_text, longest_key, normal_path
from hierax.runtime.deployment.secrets import public_setting


@dataclass
class Document:
    """The values of a deployment file after ``--set``, and the places they come from."""

    place: str  # the file's name, as errors show it
    root: dict[str, Any]  # the map at the top
    lines: dict[Keys, int]  # by path, of every value in the file
    changed: dict[Keys, str] = field(default_factory=dict)  # the ``--set`` that a value comes from
    origins: dict[Keys, str] = field(default_factory=dict)  # the parameter that it was taken from
    outer: Document | None = None  # the document whose parameters are meant, where it is another one

    @property
    def parameters(self) -> Any:
        """The map of parameters as it was given, if it is one."""
        return (self.outer or self).root.get("parameters")

    def error(self, keys: Keys, what: str) -> DeploymentError:
        """An error about the value at a path, or the one that lacks there."""
        return DeploymentError(f"{what}{self._origin(keys)}", self.where(keys), field_text(keys))

    def where(self, keys: Keys) -> str:
        """``file:line`` of the nearest value on the path that was given, or its ``--set``."""
        changed = self._changed(keys)
        if changed is not None:
            return f"--set {public_setting(changed)}"
        line = self._line(keys)
        return f"{self.place}:{line}" if line else self.place

    def rank(self, keys: Keys) -> int:
        """The place by which errors are sorted: the line, 0 for what a ``--set`` gave."""
        return 0 if self._changed(keys) is not None else self._line(keys)

    def keys(self, text: str) -> Keys:
        """A path given as text, as far as anything is on it; names may have dots, the longest that fits is taken."""
        keys: Keys = ()
        rest = normal_path(text)
        value: Any = self.root
        while rest:
            key = longest_key(value, rest)
            if key is None:
                break
            value = value[key]
            keys, rest = (*keys, key), rest[len(str(key)) + 1 :]
        if rest and (value is None or isinstance(value, (dict, list))):  # what lacks is named, too
            keys = (*keys, rest)
        return keys

    def _changed(self, keys: Keys) -> str | None:
        """The ``--set`` that a value comes from: what it changed has no line any more."""
        return self.changed.get(_nearest(keys, self.changed))

    def _line(self, keys: Keys) -> int:
        return self.lines.get(_nearest(keys, self.lines), 0)

    def _origin(self, keys: Keys) -> str:
        path = _nearest(keys, self.origins)
        if path not in self.origins:
            return ""
        place = (self.outer or self).where(("parameters", self.origins[path], *keys[len(path) :]))
        return f" (from ${{{self.origins[path]}}}, {place})"


def _nearest(keys: Keys, known: Container[Keys]) -> Keys:
    """The nearest path that is known of this one and those above it; else the root."""
    return next((keys[:length] for length in range(len(keys), -1, -1) if keys[:length] in known), ())
