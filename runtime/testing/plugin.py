"""The pytest plugin: fixtures for tests of one's own nodes and hierarchies.

Every pytest in an environment with hierax loads this module, so it imports nothing heavy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hierax.runtime.core.elements import Elements
    from hierax.runtime.core.hierarchy import Edge
    from hierax.runtime.core.node import Node
    from hierax.runtime.core.probe import Step
    from hierax.runtime.testing.recorded_node import Recorded
    from hierax.runtime.testing.runs import Ran


@dataclass(frozen=True)
class Runs:
    """What the fixture `hierax_run` gives: call it to run a hierarchy in this process."""

    folder: Path

    def __call__(
        self,
        deployment: str | Path | None = None,
        *,
        nodes: Mapping[str, Node] | None = None,
        edges: Sequence[Edge] = (),
        world: str = "world",
        epochs: int | None = None,
        seed: int = 0,
        set: Mapping[str, Any] | None = None,
    ) -> Ran:
        """Run a deployment file, or nodes and edges made by the test.

        Args:
            deployment: a file, beside the test or in the current folder, or the name of a shipped deployment.
            nodes, edges, world: in its place: nodes by name, the edges between them, and which one is N₀.
            epochs: how many; by default what the file says, or one.
            seed: of all random numbers, and of the order in which messages are delivered.
            set: changes of the file, as ``--set`` has them, by path.

        Raises:
            HieraxError: the file is wrong, the nodes form no hierarchy, or one failed.
        """
        from hierax.runtime.testing.runs import run_deployment, run_hierarchy

        if (deployment is None) == (nodes is None):
            raise TypeError("hierax_run: expected a deployment or nodes, one of them")
        if nodes is not None:
            return run_hierarchy(nodes, edges, world=world, epochs=1 if epochs is None else epochs, seed=seed)
        return run_deployment(_found(self.folder, str(deployment)), epochs=epochs, seed=seed, settings=set)


class NodeRuns:
    """What the fixture `hierax_node` gives: call it to run one node on inputs."""

    def __call__(
        self,
        node: Node,
        *,
        observations: Sequence[Elements] = (),
        tasks: Sequence[Elements] = (),
        context: Sequence[Elements] = (),
        epochs: int | None = None,
        seed: int = 0,
    ) -> list[Step]:
        """Run a node by itself, check that it is one (`hierax.runtime.testing.node.check_node`), and give what it did.

        Args:
            node: of one's own.
            observations, tasks, context: what it is given in the first epoch, the second one, …
            epochs: how many; by default as many as there are inputs.
            seed: of its random numbers.
        """
        from hierax.runtime.testing.node import check_node

        count = max(len(observations), len(tasks), len(context), 1) if epochs is None else epochs
        return check_node(node, observations=observations, tasks=tasks, context=context, epochs=count, seed=seed)


@dataclass(frozen=True)
class Recordings:
    """What the fixture `hierax_recorded` gives: call it for a node in a recording."""

    folder: Path

    def __call__(self, file: str | Path, node: str, *, epochs: int | None = None, trust: bool = False) -> Recorded:
        """A node with the inputs that it had in a recording: `run` and `check` do its epochs again.

        Args:
            file: a recording, beside the test or in the current folder.
            node: its name.
            epochs: how many at most.
            trust: load the code that it names also where it was recorded by somebody else, or on another machine.

        Raises:
            HieraxError: the file is no recording, is not trusted, has no such node, or lacks what that was given.
        """
        from hierax.runtime.testing.recorded_node import read_recorded

        return read_recorded(_found(self.folder, file), node, epochs, trust)


def _found(folder: Path, file: str | Path) -> Path:
    """A file beside the test, else in the current folder."""
    return folder / file if (folder / file).is_file() else Path(file)


@pytest.fixture
def hierax_run(request: pytest.FixtureRequest) -> Iterator[Runs]:
    """Runs hierarchies: ``hierax_run("robot.yaml", epochs=10, seed=1, set={"noise": 0})``."""
    with _import_path():
        yield Runs(request.path.parent)


@pytest.fixture
def hierax_recorded(request: pytest.FixtureRequest) -> Iterator[Recordings]:
    """A node in a recording: ``hierax_recorded("robot.mcap", "arm").check()``."""
    with _import_path():
        yield Recordings(request.path.parent)


@pytest.fixture
def hierax_node() -> NodeRuns:
    """Runs one node: ``hierax_node(Arm(), observations=[({"x": 1.0},), ()])``."""
    return NodeRuns()


@contextmanager
def _import_path() -> Iterator[None]:
    """Folders of deployments are looked into for their own test alone."""
    paths = list(sys.path)
    yield
    sys.path[:] = paths
