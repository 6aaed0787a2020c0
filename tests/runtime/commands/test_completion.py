from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.live import Live

from hierax.runtime.commands.options import deployments_here
from hierax.runtime.commands.which_launch import keys_here, nodes_here


def completed(words: str, folder: Path) -> list[str]:
    """What bash is given for the last word."""
    environment = {
        **os.environ,
        "_HIERAX_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(words.count(" ")),
    }
    command = [
        sys.executable,
        "-c",
        "import sys; sys.argv = ['hierax']; from hierax.runtime.commands.entry import entry; entry()",
    ]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=True)
    return done.stdout.split()


def test_commands_and_deployments_complete(tmp_path: Path) -> None:
    assert completed("hierax ins", tmp_path) == ["inspect"]
    assert "tracking" in completed("hierax launch tr", tmp_path)


def test_files_and_folders_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robots").mkdir()
    for name in ("robots/arm.yaml", "robots/notes.txt", "robot.yml"):
        (tmp_path / name).write_text("")
    assert deployments_here("robot") == ["robot.yml", "robots/"]
    assert deployments_here("robots/") == ["robots/arm.yaml"]
    assert deployments_here(f"{tmp_path}/robot") == [f"{tmp_path}/robot.yml", f"{tmp_path}/robots/"]
    assert "letters" in deployments_here("")


def test_nodes_and_keys_of_launches_complete(live: Live) -> None:
    assert nodes_here() == ["high", "low", "world"]
    assert "obs/world/low" in keys_here()


def test_without_a_launch_nothing_completes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert nodes_here() == []
    assert keys_here() == []


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_can_be_shown_how(shell: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hierax.runtime.commands.entry", "--show-completion", shell]
    environment = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}  # else it is the one that runs us
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert f"_HIERAX_COMPLETE=complete_{shell}" in done.stdout
