"""Files, and answers of what is no launch, made to harm: nothing of theirs is run, and each is told in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.file_attacks import ATTACKS, attacked


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return attacked(Path(tmp_path_factory.mktemp("attacks")))


@pytest.mark.parametrize("name", ATTACKS)
def test_nothing_comes_of_it(name: str, outcome: dict[str, Any]) -> None:
    assert outcome[name]["came"] == "", outcome[name]
