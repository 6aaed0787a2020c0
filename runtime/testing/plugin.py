"""The pytest plugin: fixtures for tests of one's own nodes and hierarchies.

Every pytest in an environment with hierax loads this module, so it imports nothing heavy."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hierax.runtime.core.probe import Step
    from hierax.runtime.testing.runs import Ran, Recorded


@pytest.fixture
def hierax_run(request: pytest.FixtureRequest) -> "Iterator[Callable[..., Ran]]":
    """Runs hierarchies, as `run_given` does: ``hierax_run("robot.yaml", epochs=10, seed=1, set={"noise": 0})``."""
    from hierax.runtime.testing.runs import run_given

    with _import_path():
        yield partial(run_given, request.path.parent)


@pytest.fixture
def hierax_recorded(request: pytest.FixtureRequest) -> "Iterator[Callable[..., Recorded]]":
    """A node in a recording, as `read_recorded` reads it: ``hierax_recorded("robot.mcap", "arm").check()``."""
    from hierax.runtime.testing.runs import found, read_recorded

    with _import_path():
        yield lambda file, *what, **more: read_recorded(found(request.path.parent, file), *what, **more)


@pytest.fixture
def hierax_node() -> "Callable[..., list[Step]]":
    """Runs one node: ``hierax_node(Arm(), observations=[({"x": 1.0},), ()])``, as `runs.run_node` has it."""
    from hierax.runtime.testing.runs import run_node

    return run_node


@contextmanager
def _import_path() -> Iterator[None]:
    """Folders of deployments are looked into for their own test alone, and their modules are not those of the next."""
    paths, modules = list(sys.path), set(sys.modules)
    yield
    folders = tuple(f"{path}{os.sep}" for path in set(sys.path) - set(paths))
    sys.path[:] = paths
    for name in sys.modules.keys() - modules:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(folders):
            del sys.modules[name]
