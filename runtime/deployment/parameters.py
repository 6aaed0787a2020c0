"""Changes to a deployment file as read: ``${NAME}``, a named value put where it is meant, and ``--set PATH=VALUE``."""

import re
from typing import Any

from hierax.runtime.deployment.deployment import (
    DeploymentError,
    Document,
    Keys,
    field_text,
    inside,
    longest_key,
    normal_path,
)
from hierax.runtime.deployment.model_errors import GONE
from hierax.runtime.deployment.models import field_names
from hierax.runtime.deployment.secrets import public_setting
from hierax.runtime.deployment.tree import read_tree
from hierax.runtime.loading.arguments import in_words
from hierax.runtime.loading.nearest import did_you_mean

MAX_EXPANDED = 1 << 24  # characters and values of a document after substitution
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_REFERENCE = re.compile(r"\$\$\{|\$\{(?P<name>[^}]*)\}|\$\{")
_CLOSED = (("nodes",), ("edges",), ("parameters",), ("probes",))
"""Maps that a ``--set`` changes the entries of, but adds none to."""


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


def apply_override(document: Document, text: str) -> None:
    """Change one value of a document by ``PATH=VALUE``. The path is a name in ``parameters``, or a dotted path into one
    of these or into the document; the value is read as YAML. Raises `DeploymentError` if there is no such path, with
    the nearest valid name, or the value is no YAML."""
    path, equals, value_text = text.partition("=")
    place = f"--set {public_setting(text)}"
    if not equals or not path.strip():
        raise DeploymentError("expected PATH=VALUE, e.g. noise=0.1", place)
    value = read_tree(value_text, place, has_lines=False).value
    keys = _resolve(document, path, place)
    container = _container(document.root, keys[:-1])
    container[keys[-1]] = value
    for old in [known for known in document.changed if known[: len(keys)] == keys]:
        del document.changed[old]
    document.changed[keys] = text


def _resolve(document: Document, path: str, place: str) -> Keys:
    """The keys of a path, every one checked."""
    parameters = document.root.get("parameters")
    if isinstance(parameters, dict) and path.strip() in parameters:
        return ("parameters", path.strip())
    keys: Keys = ()
    rest = normal_path(path)
    if isinstance(parameters, dict) and rest.partition(".")[0] not in field_names(()):
        rest = rest if longest_key(parameters, rest) is None else f"parameters.{rest}"
    value: Any = document.root
    while rest:
        key = _next_key(document, keys, value, rest, place)
        keys, rest = (*keys, key), rest[len(str(key)) + 1 :]
        value = _written_out(inside(value, key), keys)
    return keys


def _next_key(document: Document, keys: Keys, value: Any, rest: str, place: str) -> str | int:
    if value is not None and not isinstance(value, (dict, list)):
        raise DeploymentError(f"{field_text(keys)} is no map, nothing is inside it", place)
    key = longest_key(value, rest)
    if key is not None:
        return key
    token = rest.partition(".")[0]
    if isinstance(value, list):
        items = "1 item" if len(value) == 1 else f"{len(value)} items"
        raise DeploymentError(f"{field_text(keys)} has {items}, counted from 0", place)
    fields = field_names(keys)
    closed = keys in _CLOSED
    if token in fields or not (fields or closed):
        return token
    gone = GONE.get((*keys, token))
    if gone is not None:
        raise DeploymentError(gone, place)
    names = [*fields, *(value if closed and isinstance(value, dict) else ())]
    parameters = document.root.get("parameters")
    if not keys and isinstance(parameters, dict):
        names += parameters
    wrong = rest if keys == ("edges",) else token
    where = f" in {field_text(keys)}" if keys else ""
    raise DeploymentError(f"there is no {wrong!r}{where}{did_you_mean(wrong, names)}", place)


def _container(root: dict[str, Any], keys: Keys) -> Any:
    """The map or list at a path; maps that lack on the way are made, short forms written out."""
    container: Any = root
    for depth, key in enumerate(keys, 1):
        value = _written_out(inside(container, key), keys[:depth])
        container[key] = {} if value is None else value
        container = container[key]
    return container


def _written_out(value: Any, keys: Keys) -> Any:
    """An edge's function in full, where its name alone is given."""
    is_short = len(keys) == 3 and keys[0] == "edges" and isinstance(value, str)
    return {"function": value} if is_short else value
