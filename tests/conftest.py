"""For all tests: how two workers share them, and where launches leave their logs."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

# Nothing is judged by how long it takes: machines are shared.
settings.register_profile("hierax", deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("hierax")

STARTING = (
    "tests/benchmarks/",
    "tests/docs/",
    "tests/nodes/causal_tree/",
    "tests/nodes/picking/",
    "tests/nodes/benchmarks/",
    "tests/nodes/commands/",
    "tests/runtime/commands/",
    "tests/runtime/core/test_digest.py",
    "tests/runtime/launch/",
    "tests/runtime/recording/",
    "tests/runtime/recovery/",
    "tests/runtime/host/test_interpreter.py",
    "tests/runtime/loading/test_loader.py",
    "tests/runtime/host/test_streams.py",
    "tests/runtime/testing/",
    "tests/runtime/tools/",
    "tests/runtime/transport/",
    "tests/runtime/viewing/",
    "tests/runtime/watch/",
    "tests/test_docs_testing.py",
    "tests/test_readme.py",
)
"""Tests that start processes, or look for what processes leave on the machine: one worker has them all, one by one."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """How `make test` divides the tests among its workers."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return "starting" if nodeid.startswith(STARTING) else nodeid.partition("::")[0]

    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """`make test-quick` leaves out what starts processes."""
    for item in items:
        if item.nodeid.startswith(STARTING):
            item.add_marker("processes")


@pytest.fixture(scope="session", autouse=True)
def _logs_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(os.environ, "XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
