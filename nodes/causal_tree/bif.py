"""Networks in BIF files, whose structure pyAgrum reads."""

import math
import re
import tempfile
import warnings
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.errors import NetworkError
from hierax.nodes.causal_tree.extended_floats import Floats
from hierax.nodes.causal_tree.network import MAX_STATES, check_tables

# No pattern looks for an end that may be far off, or nowhere, or a file of nothing but beginnings would take for ever.
_COMMENT = re.compile(r'"[^"]*(?:"|\Z)|//[^\n]*|/\*(?:[^*]|\*(?!/))*(?:\*/|\Z)')  # or a text, in which there is none
_VARIABLE = re.compile(r'\bvariable\s+"?([^"\s{]+)"?\s*\{|\[\s*([0-9]{1,18})\s*\]')  # its name, or its states
_TABLE = re.compile(r"\bprobability\s*\(([^){]*)")
_BLOCK = re.compile(r"(\bprobability\b[^{]*)(\{[^}]*)?")
# What is no number of a table: texts, and states. Then such a number.
_NUMBER = re.compile(r'"[^"]*"?|\([^)]*|(?<![\w.])([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)(?![\w.])')
_TEXT = re.compile(r'"[^"]*"?')
_ROW = re.compile(r"\s*(table|default|\([^)]*\))(.*)", re.DOTALL)  # what a row of a table is of, and its numbers
_MOST = 1 << 24  # so far single precision counts


def description_from(path: Path, text: str) -> list[dict[str, Any]]:
    """The description of the network in a BIF file with this text. Raises NetworkError: it is none, or too large.

    pyAgrum reads numbers in single precision. So it is given their places in a list of them instead, in a file beside
    it: whole numbers, which it reads exactly."""
    plain = _COMMENT.sub(_blank, text)
    _check_sizes(plain)
    try:
        pyagrum = import_quietly("pyagrum")
    except ModuleNotFoundError as error:
        raise NetworkError("BIF needs pyAgrum, which is not installed: pip install 'hierax[bayes]'") from error
    places: dict[str, int] = {}
    numbered = _BLOCK.sub(lambda block: block[1] + _numbered(block[2] or "", places), plain)
    if len(places) >= _MOST:
        raise NetworkError(f"has {len(places)} different numbers; fewer than {_MOST} are allowed")
    numbers = np.array([0.0, *map(float, places)])  # what no line of a table tells is 0
    with tempfile.NamedTemporaryFile("w", suffix=".bif", encoding="utf-8") as file:
        file.write(numbered)
        file.flush()
        try:
            net = pyagrum.loadBN(file.name)
        except Exception as error:  # pyAgrum has many; of the file itself it tells where it is wrong
            raise NetworkError(f"is no BIF: {_told(pyagrum, path) or error}") from error
    _check_rows(plain, {net.variable(node).name(): net.variable(node).domainSize() for node in net.nodes()})
    return description_of(net, numbers)


def description_of(net: Any, numbers: Floats | None = None) -> list[dict[str, Any]]:
    """The description of a network of pyAgrum's, a ``pyagrum.BayesNet``, whose tables have the places of what they tell
    in a list of numbers, if one is given."""
    description = []
    for node in sorted(net.nodes()):
        variable, table = net.variable(node), net.cpt(node)
        name = variable.name()
        parents = [axis for axis in table.names if axis != name]
        axes = table.names[::-1]  # its arrays have the axes in the opposite order, whichever the table has
        array = np.asarray(table.toarray(), np.float64).transpose([axes.index(axis) for axis in (*parents, name)])
        told = array if numbers is None else numbers[array.astype(np.intp)]
        key = "cpt" if parents else "prior"
        description.append({"id": name, "states": list(variable.labels()), "parents": parents, key: told.tolist()})
    return description


def import_quietly(name: str) -> Any:
    """A module whose import warns; where warnings are errors, those would end the process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_module(name)


def _blank(found: re.Match[str]) -> str:
    """A comment as so many lines, a text as it is."""
    return found[0] if found[0].startswith('"') else " " + "\n" * found[0].count("\n")


def _numbered(block: str, places: dict[str, int]) -> str:
    """A table with places in place of numbers, from 1 on, where new ones are added."""

    def place(found: re.Match[str]) -> str:
        return found[0] if found[1] is None else str(places.setdefault(found[1], len(places) + 1))

    return _NUMBER.sub(place, block)


def _check_sizes(text: str) -> None:
    """Whether the tables that a file announces may be had: pyAgrum makes them before it reads their numbers."""
    states: dict[str, int] = {}
    opened = ""
    for name, count in _VARIABLE.findall(text):
        if opened and count:
            states[opened] = int(count)
        opened = name
    heads = list(map(_names, _TABLE.findall(text)))
    many = next((name for name, count in states.items() if count > MAX_STATES), None)
    if many is not None:
        raise NetworkError(f"states: {states[many]:.3g} of them; at most {MAX_STATES} are allowed", many)
    check_tables({head[0]: [states.get(name, 1) for name in head] for head in heads if head})


def _names(head: str) -> list[str]:
    """Of whom a table is: the node, then its parents."""
    return re.findall(r'[^\s,|"]+', head)


def _check_rows(text: str, states: Mapping[str, int]) -> None:
    """Whether there is one row of a kind, with as many numbers as it needs: of several pyAgrum takes the last one, of
    numbers it leaves out further ones, and takes 0 for those that are not there."""
    seen: set[tuple[str, str]] = set()
    for before, block in _BLOCK.findall(text):
        names = [name for head in _TABLE.findall(before) for name in _names(head)]
        if not names:  # something else is called so
            continue
        for row in filter(None, map(_ROW.match, _TEXT.sub("", block[1:]).split(";"))):
            kind = "".join(row[1].split())
            wanted = math.prod(states.get(name, 1) for name in (names if kind == "table" else names[:1]))
            count = sum(1 for found in _NUMBER.finditer(row[2]) if found[1])
            if count != wanted:
                raise NetworkError(f"{kind}: expected {wanted} numbers, got {count}", names[0])
            if (names[0], kind) in seen:
                raise NetworkError(f"{kind}: expected one such row, got two", names[0])
            seen.add((names[0], kind))


def _told(pyagrum: Any, path: Path) -> str:
    """What pyAgrum says of a file, in one line; empty: nothing."""
    try:
        pyagrum.loadBN(str(path))
    except Exception as error:
        return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
    return ""
