"""Looking at a launch that runs, from outside of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.transport.inspection import LaunchClient
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value

Answer = dict[str, Any]

_OF_NODE = {"process", "state"}


@dataclass(frozen=True)
class LaunchState:
    """A launch, as its keeper tells of it.

    Attributes:
        hierarchy, run: what is run, and its identification.
        epoch: the last one committed, as far as the keeper has heard.
        roster: the version in force.
        nodes: by name: ``process``, ``pid``, ``state``, ``restarts``, ``instance``.
    """

    hierarchy: str
    run: str
    epoch: int
    roster: int
    nodes: Mapping[str, Mapping[str, Any]]

    @property
    def keys(self) -> Keys:
        """Of the run."""
        return Keys(self.hierarchy, self.run)


class LaunchInspector:
    """Looks at one launch.

    Args:
        client: asks the launch.
    """

    def __init__(self, client: LaunchClient) -> None:
        self._client = client

    def look(self) -> LaunchState:
        """What runs now.

        Raises:
            HieraxError: there is no answer, or none that can be read.
        """
        answer = self._client.ask_keeper({"ask": "ps"})
        fields = {"hierarchy": str, "run": str, "epoch": int, "roster": int, "nodes": dict}
        said = answer if isinstance(answer, dict) else {}
        nodes = said.get("nodes")
        rows = nodes.values() if isinstance(nodes, dict) else ()
        read = all(isinstance(said.get(field), kind) for field, kind in fields.items())
        if not read or not all(isinstance(row, dict) and row.keys() >= _OF_NODE for row in rows):
            raise HieraxError(str(said.get("refusal") or "the launch gave an answer that cannot be read"))
        return LaunchState(*(said[field] for field in fields))

    def ask(self, seen: LaunchState, question: Mapping[str, Value], names: Collection[str]) -> dict[str, Answer]:
        """What nodes answer; of a node's processes, only the one that has its place counts.

        Args:
            seen: the launch.
            question: see `hierax.runtime.launch.inspection_server`.
            names: of the nodes.
        """
        found: dict[str, Answer] = {}
        for name, answers in self._client.ask_nodes(seen.keys, question, names).items():
            token = seen.nodes[name]["process"]
            for answer in answers:
                if isinstance(answer, dict) and answer.get("process") == token:
                    found[name] = answer
        return found

    def pairs(self, seen: LaunchState) -> list[tuple[str, str]]:
        """The edges of a launch, as (lower, upper), in order."""
        answers = self.ask(seen, {"look": "neighbours"}, seen.nodes)
        return sorted(
            (lower, name)
            for name, answer in answers.items()
            for lower in answer.get("below", ())
            if isinstance(lower, str)
        )

    def state(self, seen: LaunchState, name: str) -> Answer:
        """What a node believes.

        Raises:
            HieraxError: there is no such node, or its process does not answer.
        """
        check_name(name, seen)
        answer = self.ask(seen, {"look": "state"}, [name]).get(name)
        if answer is None:
            state = seen.nodes[name]["state"]
            raise HieraxError(f"{name}: its process does not answer; the launch says that it is {state}")
        if "refusal" in answer:
            raise HieraxError(f"{name}: {answer['refusal']}")
        return answer


def check_name(name: str, seen: LaunchState) -> None:
    """Whether a launch has a node.

    Raises:
        HieraxError: it has none of this name; with the nearest one.
    """
    if name not in seen.nodes:
        known = did_you_mean(name, seen.nodes, "the nodes are")
        raise HieraxError(f"there is no node {name!r} in {seen.hierarchy}, run {seen.run}{known}")
