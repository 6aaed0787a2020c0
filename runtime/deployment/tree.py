"""YAML as values that remember their lines.

The core schema of YAML 1.2 is read (``1e-3`` is a number, ``on`` and ``no`` are text), with merge keys; a number that
begins with a superfluous zero (``000001``) is text. Unlike YAML allows, keys are text and no map holds a key twice."""

import base64
import binascii
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import yaml

from hierax.runtime.deployment.deployment import DeploymentError, Keys, edge_name, field_text
from hierax.schemas.limits import MAX_DEPTH

MAX_TEXT_CHARS = 1 << 22
MAX_PARTS = 1 << 18  # values in a document, aliases and what '<<' brings in counted wherever they stand
_TAG = "tag:yaml.org,2002:"
_INTEGERS = range(-(1 << 63), 1 << 64)
_BOOLS = {"true": True, "false": False}


class _TooMuch(Exception):  # noqa: N818 - told as another error, with its place
    """The text has more than is allowed."""


class _Loader(yaml.SafeLoader):
    """Stops at what is too much while it reads: reading goes on for a minute where a text is a list of two million."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 - the base class's name
    _composed = 0
    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._composed += 1
        if self._composed > 2 * MAX_PARTS:  # keys are nodes, too
            raise _TooMuch(f"the document has more than {MAX_PARTS} values")
        if self._depth > MAX_DEPTH + 1:
            raise _TooMuch(f"nested deeper than {MAX_DEPTH} levels")
        self._depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node


for _kind, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?(0|[1-9][0-9]*)|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+\.[0-9]*)([eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
    ("merge", r"<<", ["<"]),
):
    _Loader.add_implicit_resolver(_TAG + _kind, re.compile(rf"(?:{_pattern})\Z"), _first)

RESOLVERS = _Loader.yaml_implicit_resolvers
"""By its first character, what a plain scalar may be, and how that looks."""


@dataclass
class Tree:
    """Values read from YAML."""

    place: str  # what errors name: the file, or the ``--set``
    has_lines: bool = True  # whether they name the line, too
    value: Any = None  # the root
    lines: dict[Keys, int] = field(default_factory=dict)  # of every value, by path, from 1; of a map's entry, its key's

    def at(self, line: int) -> str:
        """A line's place, for errors."""
        return f"{self.place}:{line}" if self.has_lines else self.place


def read_tree(text: str, place: str, has_lines: bool = True) -> Tree:
    """Read a YAML document. The place is the file's name, or the ``--set``, for errors, which name the line, too, where
    `has_lines`. Raises `DeploymentError` if the text is no YAML, or more than is allowed here."""
    tree = Tree(place, has_lines)
    if len(text) > MAX_TEXT_CHARS:
        raise DeploymentError(f"has {len(text)} characters; at most {MAX_TEXT_CHARS} are allowed", place)
    try:
        root = _composed(text, tree)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        character = chr(error.character) if isinstance(error.character, int) else error.character
        raise DeploymentError(f"character {character!r} is not allowed in YAML", tree.at(line)) from error
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, tree) from error
    except _TooMuch as error:
        raise DeploymentError(str(error), place) from error
    if root is not None:
        tree.value = _Builder(tree).build(root, ())
    return tree


def _composed(text: str, tree: Tree) -> yaml.Node | None:
    """A document's root as `yaml.compose` gives it. Raises `DeploymentError` at a number that is too large for it."""
    loader = _Loader(text)
    try:
        root: yaml.Node | None = loader.get_single_node()
    except (ValueError, OverflowError) as error:  # of an escape, as in "\UFFFFFFFF", or of a version, as in %YAML
        what = f"found a number that is too large; that of a character is 10FFFF at most (column {loader.column + 1})"
        raise DeploymentError(f"no valid YAML: {what}", tree.at(loader.line + 1)) from error
    finally:
        loader.dispose()
    return root


def _syntax_error(error: yaml.MarkedYAMLError, tree: Tree) -> DeploymentError:
    problem = (error.problem or "").replace("'<stream end>'", "the end of the text")
    context = ""
    if error.context:
        since = error.context_mark
        begun = f" that begins in line {since.line + 1}" if since is not None and tree.has_lines else ""
        context = f" {error.context}{begun}"
    mark = error.problem_mark or error.context_mark
    if mark is None:
        return DeploymentError(f"no valid YAML: {problem}{context}", tree.place)
    what = f"no valid YAML: {problem}{context} (column {mark.column + 1})"
    return DeploymentError(what, tree.at(mark.line + 1))


def _is_member(of: yaml.MappingNode, value: yaml.Node) -> bool:
    """Whether an entry of a map in braces has no value, as in a set, ``{2, 5}``."""
    return bool(of.flow_style) and isinstance(value, yaml.ScalarNode) and value.value == "" and value.style is None


class _Builder:
    """Makes values of YAML's nodes; fills in the tree's lines."""

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.parts = 0

    def build(self, node: yaml.Node, keys: Keys) -> Any:
        self.count(1, node, keys)
        if len(keys) > MAX_DEPTH:
            raise self.error(node, keys[:4], f"nested deeper than {MAX_DEPTH} levels")
        self.tree.lines.setdefault(keys, node.start_mark.line + 1)
        if isinstance(node, yaml.MappingNode) and node.tag == f"{_TAG}map":
            return self.mapping(node, keys)
        if isinstance(node, yaml.SequenceNode) and node.tag == f"{_TAG}seq":
            return [self.build(item, (*keys, index)) for index, item in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node, keys)
        raise self.error(node, keys, f"the tag {_short(node.tag)} cannot be used here")

    def count(self, parts: int, node: yaml.Node, keys: Keys) -> None:
        """Count so many values more."""
        self.parts += parts
        if self.parts > MAX_PARTS:
            raise self.error(node, keys[:4], f"the document has more than {MAX_PARTS} values")

    def mapping(self, node: yaml.MappingNode, keys: Keys) -> dict[str, Any]:
        result: dict[str, Any] = {}
        seen: dict[str, int] = {}
        merged: list[tuple[yaml.Node, yaml.Node]] = []
        for key_node, value_node in node.value:
            if key_node.tag == f"{_TAG}merge":
                merged += self.merged(value_node, keys)
                continue
            key = self.key(key_node, keys, _is_member(node, value_node))
            line = key_node.start_mark.line + 1
            if key in seen:
                raise self.error(key_node, (*keys, key), f"given twice, in line {seen[key]} and in line {line}")
            seen[key] = line
            self.entry(result, key_node, value_node, (*keys, key))
        for key_node, value_node in merged:
            key = self.key(key_node, keys)
            if key not in result:
                self.entry(result, key_node, value_node, (*keys, key))
        return result

    def entry(self, result: dict[str, Any], key_node: yaml.Node, value_node: yaml.Node, keys: Keys) -> None:
        self.tree.lines[keys] = key_node.start_mark.line + 1
        result[str(keys[-1])] = self.build(value_node, keys)

    def key(self, node: yaml.Node, keys: Keys, member: bool = False) -> str:
        """A key, which is text; a member of a set is taken as the text that stands there."""
        if member and isinstance(node, yaml.ScalarNode):
            return str(node.value)
        if not isinstance(node, yaml.ScalarNode) or node.tag != f"{_TAG}str":
            given = node.value if isinstance(node, yaml.ScalarNode) else "a list or a map"
            raise self.error(node, keys, f"a key must be text, not {given}; put quotes around it")
        key = str(self.scalar(node, keys))
        return edge_name(key) if keys == ("edges",) else key

    def merged(self, node: yaml.Node, keys: Keys) -> list[tuple[yaml.Node, yaml.Node]]:
        """The entries that a merge key brings in, nearest first."""
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        entries: list[tuple[yaml.Node, yaml.Node]] = []
        for source in sources:
            if not isinstance(source, yaml.MappingNode):
                raise self.error(source, keys, "'<<' takes a map, or a list of maps")
            self.count(len(source.value), source, keys)
            entries += source.value
        if any(key_node.tag == f"{_TAG}merge" for key_node, _ in entries):
            raise self.error(node, keys, "'<<' takes a map that has no '<<' itself")
        return entries

    def scalar(self, node: yaml.ScalarNode, keys: Keys) -> Any:
        read = _SCALARS.get(node.tag)
        if read is None:
            raise self.error(node, keys, f"the tag {_short(node.tag)} cannot be used here")
        try:
            return read(node.value)
        except (ValueError, binascii.Error) as error:
            given = node.value if len(node.value) <= 40 else f"{node.value[:40]}…"
            raise self.error(node, keys, f"{given!r} is no {_short(node.tag)}: {error}") from error

    def error(self, node: yaml.Node, keys: Keys, what: str) -> DeploymentError:
        return DeploymentError(what, self.tree.at(node.start_mark.line + 1), field_text(keys))


def _short(tag: str) -> str:
    return tag.replace(_TAG, "!!")


def _null(text: str) -> None:
    if text not in ("", "~", "null", "Null", "NULL"):
        raise ValueError("expected null")


def _bool(text: str) -> bool:
    if text.lower() not in _BOOLS:
        raise ValueError("expected true or false")
    return _BOOLS[text.lower()]


def _int(text: str) -> int:
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    if len(text) > 100 or (number := int(text, base)) not in _INTEGERS:
        raise ValueError("expected a whole number of 64 bits")
    return number


def _text(text: str) -> str:
    text.encode()  # half of a surrogate pair, written as an escape, cannot travel
    return text


_SCALARS: dict[str, Callable[[str], Any]] = {
    f"{_TAG}null": _null,
    f"{_TAG}bool": _bool,
    f"{_TAG}int": _int,
    f"{_TAG}float": lambda text: float(text.lower().replace(".inf", "inf").replace(".nan", "nan")),
    f"{_TAG}str": _text,
    f"{_TAG}merge": _text,
    f"{_TAG}binary": lambda text: base64.b64decode("".join(text.split()), validate=True),
}
