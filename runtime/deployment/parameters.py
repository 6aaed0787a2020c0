"""``${NAME}`` in a deployment file: named values put where they are meant."""

from __future__ import annotations

import re
from typing import Any

from hierax.runtime.deployment.document import Document
from hierax.runtime.deployment.paths import DeploymentError, Keys
from hierax.runtime.loading.arguments import in_words
from hierax.runtime.loading.nearest import did_you_mean

MAX_EXPANDED = 1 << 24  # characters and values of a document after substitution
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_REFERENCE = re.compile(r"\$\$\{|\$\{(?P<name>[^}]*)\}|\$\{")


def substitute(document: Document) -> dict[str, Any]:
    """The document's values with every ``${NAME}`` replaced; `document.origins` is filled in. A scalar that is just
    ``${NAME}`` becomes the value itself, whatever its type; within longer text it is written out. ``$${`` stands for a
    plain ``${``. A parameter may refer to those above it. Raises `DeploymentError` if a name is unknown (with the
    nearest valid one), a list or map would have to stand within text, or the document grows out of bounds."""
    substitution = _Substitution(document)
    parameters = {} if document.parameters is None else document.parameters
    if not isinstance(parameters, dict):
        raise document.error(("parameters",), f"expected a map from names to values, got {in_words(parameters)}")
    for name, value in parameters.items():
        substitution.define(name, value)
    return {
        key: substitution.values if key == "parameters" else substitution.replace(value, (key,))
        for key, value in document.root.items()
    }


class _Substitution:
    def __init__(self, document: Document) -> None:
        self.document = document
        self.values: dict[str, Any] = {}
        self.sizes: dict[str, int] = {}
        self.size = 0

    def define(self, name: str, value: Any) -> None:
        if not _NAME.fullmatch(name):
            what = f"{name!r} is no parameter's name: expected letters, digits, '_' or '-', beginning with a letter"
            raise self.document.error(("parameters", name), what)
        before = self.size
        self.values[name] = self.replace(value, ("parameters", name))
        self.sizes[name] = self.size - before

    def replace(self, value: Any, keys: Keys) -> Any:
        if isinstance(value, dict):
            self.grow(len(value) + 1, keys)
            return {key: self.replace(item, (*keys, key)) for key, item in value.items()}
        if isinstance(value, list):
            self.grow(len(value) + 1, keys)
            return [self.replace(item, (*keys, index)) for index, item in enumerate(value)]
        if not isinstance(value, str):
            self.grow(1, keys)
            return value
        whole = _REFERENCE.fullmatch(value)
        if whole and whole["name"] is not None:
            name = self.known(whole["name"], keys)
            self.grow(self.sizes[name] + 1, keys)
            self.document.origins[keys] = name
            return self.values[name]
        return self.text(value, keys)

    def text(self, value: str, keys: Keys) -> str:
        def grown(match: re.Match[str]) -> str:
            written = self.written(match, keys)
            self.grow(len(written), keys)
            return written

        self.grow(len(value) + 1, keys)
        return _REFERENCE.sub(grown, value)

    def written(self, match: re.Match[str], keys: Keys) -> str:
        if match[0] == "$${":
            return "${"
        if match["name"] is None:
            raise self.document.error(keys, "'${' without its '}'; write '$${' for a plain '${'")
        name = self.known(match["name"], keys)
        value = self.values[name]
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, (str, int, float)):
            return str(value)
        raise self.document.error(keys, f"${{{name}}} is {in_words(value)} and cannot stand within text")

    def known(self, name: str, keys: Keys) -> str:
        if name in self.values:
            return name
        above = " above it" if keys[0] == "parameters" else ""
        if not self.values:
            raise self.document.error(keys, f"unknown parameter ${{{name}}}: there are no parameters{above}")
        nearest = did_you_mean(name, self.values, f"the parameters{above} are")
        raise self.document.error(keys, f"unknown parameter ${{{name}}}{nearest}")

    def grow(self, size: int, keys: Keys) -> None:
        self.size += size
        if self.size > MAX_EXPANDED:
            raise DeploymentError("the parameters make the document too large", self.document.where(keys))
