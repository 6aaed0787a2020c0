"""``--set PATH=VALUE``: changes to a deployment file from the command line."""

from __future__ import annotations

from typing import Any

from hierax.runtime.deployment.document import Document
from hierax.runtime.deployment.models import field_names
from hierax.runtime.deployment.paths import DeploymentError, Keys, field_text, inside, longest_key, normal_path
from hierax.runtime.deployment.secrets import public_setting
from hierax.runtime.deployment.tree import read_tree
from hierax.runtime.loading.nearest import did_you_mean

_CLOSED = (("nodes",), ("edges",), ("parameters",), ("probes",))
"""Maps that a ``--set`` changes the entries of, but adds none to."""


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
