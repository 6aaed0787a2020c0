"""A project that `hierax new` makes works as its README says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hierax.runtime.commands.new import make_project
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment


def test_all_files_are_there_and_filled_in(tmp_path: Path) -> None:
    made = make_project(tmp_path / "my-house")
    assert [path.name for path in made] == [
        "README.md",
        "my-house.yaml",
        "my_house.py",
        "test_my_house.py",
        "pytest.ini",
    ]
    for path in made:
        text = path.read_text(encoding="utf-8")
        assert "@" not in text.replace("@pytest", "")
    assert read_deployment(made[1]).name == "my-house"


def test_its_tests_pass_with_warnings_as_errors_also_within_a_project_of_other_habits(tmp_path: Path) -> None:
    make_project(tmp_path / "house")
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\naddopts = ["--import-mode=importlib"]\n')
    command = [sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path / "house", capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 passed" in done.stdout


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "house"
    folder.mkdir()
    make_project(folder)  # it was empty
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(HieraxError, match="is there already, and nothing is overwritten"):
        make_project(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    (tmp_path / "file").write_text("x")
    with pytest.raises(HieraxError, match="is there already"):
        make_project(tmp_path / "file")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("numpy", "there is a Python module 'numpy' already"),
        ("json", "there is a Python module 'json' already"),
        ("9lives", "begin it with a letter"),
        ("my house", "is no project's name"),
        ("class", "gives no name of a Python module"),
    ],
)
def test_names_that_cannot_be(tmp_path: Path, name: str, what: str) -> None:
    with pytest.raises(HieraxError, match=what):
        make_project(tmp_path / name)
    assert not (tmp_path / name).exists()


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(HieraxError, match="cannot be written: Not a directory"):
        make_project(tmp_path / "file" / "house")
