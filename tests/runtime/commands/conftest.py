"""A launch for tests of commands that look at one: world -> low -> high."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.live import Live


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    live = Live(tmp_path_factory.mktemp("live"), pace_s=0.01)
    yield live
    live.close()


@pytest.fixture
def live(running: Live, monkeypatch: pytest.MonkeyPatch) -> Live:
    """The launch, which is the only one that commands of this process see."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(running.folder))
    return running
