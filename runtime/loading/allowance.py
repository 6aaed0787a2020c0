"""Which code may be loaded: asked before anything is imported that a file, a message or a recording names.

A deployment file allows the modules that it names itself and those that it lists as
``modules``. What comes later, from whomever, is held against that: rosters, changes,
orders, records, recordings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hierax.runtime.core.errors import HieraxError
from hierax.schemas.changes import Attach, Change, Replace
from hierax.schemas.roster import Reference, Roster, RosterEdge

TARGET_PATTERN = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*$"
"""``package.module:name``: one name in a module, nothing within what that names."""

MOST_REFUSALS = 50
"""So many different refusals are told by a process; more are an attack, of which enough is known then."""

_TARGET = re.compile(TARGET_PATTERN)


class NotAllowedError(HieraxError):
    """Something names code that may not be loaded.

    Attributes:
        what: the target, and what would have to be done.
        where: the path in the roster, which is also that in the deployment file.
    """

    def __init__(self, what: str, where: str) -> None:
        self.what = what
        self.where = where
        super().__init__(f"{where}: {what}")


def is_target(text: str) -> bool:
    """Whether a text is written as ``package.module:name``."""
    return _TARGET.match(text) is not None and not text.endswith("\n")


def module_of(target: str) -> str:
    """The module of ``package.module:name``."""
    return target.partition(":")[0]


@dataclass(frozen=True)
class Allowance:
    """The modules from which code may be loaded.

    Attributes:
        modules: ``package.module`` is that module alone, ``package.*`` the package and all that is inside it.
    """

    modules: tuple[str, ...]

    def with_modules(self, modules: Iterable[str]) -> Allowance:
        """This one, and further modules."""
        return Allowance(tuple(sorted({*self.modules, *modules})))

    def covers(self, module: str) -> bool:
        """Whether code may be loaded from a module."""
        return any(_covers(pattern, module) for pattern in self.modules)

    def check(self, target: str, where: str) -> None:
        """Whether a class or function may be loaded.

        Args:
            target: ``package.module:name``.
            where: the field that names it.

        Raises:
            NotAllowedError: it may not, or is written otherwise.
        """
        if not is_target(target):
            raise NotAllowedError(f"expected 'package.module:name', one name in a module, got {target!r:.80}", where)
        module = module_of(target)
        if not self.covers(module):
            what = (
                f"{target!r} may not be loaded in this run: its deployment file neither names the module {module!r} "
                f"nor allows it; add {module!r} to 'modules' there and start the run anew"
            )
            raise NotAllowedError(what, where)

    def check_all(self, named: Roster | Change) -> None:
        """Whether all code that a roster or change names may be loaded.

        Raises:
            NotAllowedError: the first that may not, with the field that names it.
        """
        for where, reference in references(named):
            self.check(reference.target, where)

    def check_part(self, roster: Roster, name: str) -> None:
        """Whether all code may be loaded that a roster names for one node and its edges.

        Raises:
            NotAllowedError: as `check_all`.
        """
        nodes = {name: roster.nodes[name]} if name in roster.nodes else {}
        edges = tuple(edge for edge in roster.edges if name in edge.pair)
        self.check_all(Attach(nodes, edges))


ANYTHING = Allowance(("*",))
"""Whatever is named: for who has said that its source is trusted. No file can say so."""


class Refusals:
    """What was refused, to say each once, and no more than some: whoever is refused may ask for ever."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def is_new(self, what: str) -> bool:
        """Whether this is to be told."""
        if what in self._told or len(self._told) >= MOST_REFUSALS:
            return False
        self._told.add(what)
        return True


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
        for kind in ("sense", "task", "context"):
            reference: Reference | None = getattr(edge, kind)
            if reference is not None:
                yield f"edges.{edge.lower} -> {edge.upper}.{kind}", reference


def _covers(pattern: str, module: str) -> bool:
    package = pattern.removesuffix(".*")
    if pattern == "*":
        return True
    return module == package or (package != pattern and module.startswith(f"{package}."))
