from __future__ import annotations

import json
from pathlib import Path

import pytest

from hierax.runtime.commands.main import main


def test_a_project_runs_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "warm-house"]) == 0
    out = capsys.readouterr().out
    assert "made warm-house/warm-house.yaml" in out
    assert out.splitlines()[-3:] == ["  cd warm-house", "  hierax run warm-house.yaml", "  pytest"]
    monkeypatch.syspath_prepend(tmp_path / "warm-house")
    assert main(["validate", "warm-house/warm-house.yaml"]) == 0
    capsys.readouterr()
    assert main(["run", "warm-house/warm-house.yaml", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["nodes"]["thermostat"]["metrics"]["error_celsius"] < 1.0


def test_a_name_that_is_no_text_in_yaml(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["new", str(tmp_path / "true")]) == 0
    monkeypatch.syspath_prepend(tmp_path / "true")
    assert main(["validate", str(tmp_path / "true" / "true.yaml")]) == 0, capsys.readouterr().err


def test_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", str(tmp_path / "cold-house"), "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [Path(path).name for path in told["files"]] == [
        "README.md",
        "cold-house.yaml",
        "cold_house.py",
        "test_cold_house.py",
        "pytest.ini",
    ]


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").write_text("mine")
    assert main(["new", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert "is there already, and nothing is overwritten" in said.err
