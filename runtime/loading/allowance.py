"""Which code may be loaded: asked before anything is imported that a file, a message or a recording names.

A deployment file allows the modules that it names itself and those that it lists as ``modules``. What comes later, from
whomever, is held against that: rosters, changes, orders, records, recordings."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hierax.runtime.core.errors import PlacedError
from hierax.schemas.roster import FUNCTIONS, Attach, Change, Reference, Replace, Roster, RosterEdge

TARGET_PATTERN = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*$"
"""``package.module:name``: one name in a module, nothing within what that names."""

MOST_REFUSALS = 50
"""So many different refusals are told by a process; more are an attack, of which enough is known then."""

_TARGET = re.compile(TARGET_PATTERN)


class NotAllowedError(PlacedError):
    """Something names code that may not be loaded: `what`, and what would have to be done; and `where`, as a path."""


def is_target(text: str) -> bool:
    """Whether a text is written as ``package.module:name``."""
    return _TARGET.match(text) is not None and not text.endswith("\n")


def module_of(target: str) -> str:
    """The module of ``package.module:name``."""
    return target.partition(":")[0]


@dataclass(frozen=True)
class Allowance:
    """The modules from which code may be loaded."""

    modules: tuple[str, ...]  # ``package.module``, that alone, or ``package.*``, the package and all inside it

    def with_modules(self, modules: Iterable[str]) -> "Allowance":
        """This one, and further modules."""
        return Allowance(tuple(sorted({*self.modules, *modules})))

    def covers(self, module: str) -> bool:
        """Whether code may be loaded from a module."""
        packages = [pattern.removesuffix("*") for pattern in self.modules if pattern == "*" or pattern.endswith(".*")]
        inside = any(f"{module}.".startswith(package) for package in packages)
        return inside or module in self.modules

    def check(self, target: str, where: str) -> None:
        """Raise `NotAllowedError` if a target may not be loaded, or is none; `where` is the field that names it."""
        if not is_target(target):
            raise NotAllowedError(f"expected 'package.module:name', one name in a module, got {target!r:.80}", where)
        module = module_of(target)
        if not self.covers(module):
            what = f"its deployment file neither names the module {module!r} nor allows it"
            instead = f"add {module!r} to 'modules' there and start the run anew"
            raise NotAllowedError(f"{target!r} may not be loaded in this run: {what}; {instead}", where)

    def check_all(self, named: Roster | Change) -> None:
        """Raise `NotAllowedError` of the first code that a roster or change names which may not be loaded."""
        for where, reference in references(named):
            self.check(reference.target, where)

    def check_part(self, roster: Roster, name: str) -> None:
        """Raise `NotAllowedError` as `check_all` does, of what a roster names for one node and its edges."""
        nodes = {name: roster.nodes[name]} if name in roster.nodes else {}
        self.check_all(Attach(nodes, roster.edges_of(name)))


ANYTHING = Allowance(("*",))  # whatever is named: for who has said that its source is trusted. No file can say so.


class Refusals:
    """What was refused, to say each once, and no more than some: whoever is refused may ask for ever."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def is_new(self, what: str) -> bool:
        """Whether this is to be told."""
        is_new = what not in self._told and len(self._told) < MOST_REFUSALS
        self._told.update([what] if is_new else [])
        return is_new


def references(named: Roster | Change) -> Iterable[tuple[str, Reference]]:
    """All code that a roster or change names, and the field that names it."""
    nodes: Mapping[str, Reference] = {}
    edges: Iterable[RosterEdge] = ()
    if isinstance(named, (Roster, Attach)):
        nodes, edges = named.nodes, named.edges
    elif isinstance(named, Replace):
        nodes, edges = {named.name: named.reference}, named.edges or ()
    for name in sorted(nodes):
        yield f"nodes.{name}.class", nodes[name]
    for edge in edges:
        for kind in FUNCTIONS:
            reference: Reference | None = getattr(edge, kind)
            if reference is not None:
                yield f"edges.{edge.lower} -> {edge.upper}.{kind}", reference
