"""A model in Promela, as Spin goes through all its states."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from support.sweep import SWEEP

LIMIT_S = 300
DEPTH = 5000
MEMORY_MB = 4000

# What one verifier of many computes is little; it is compiled in a thirtieth of the time where tcc is there.
COMPILER = ["gcc", "-O1"] if SWEEP else [shutil.which("tcc") or "gcc", "-O0"]

needs_spin = pytest.mark.skipif(
    not (shutil.which("spin") and shutil.which("gcc")), reason="spin or gcc is not there; `make model` installs spin"
)


class Model(NamedTuple):
    """A file, and what in its traces tells of a step."""

    path: Path
    steps: str  # how a line begins that does, as a regular expression

    def mistakes(self) -> set[str]:
        """Those that its macros plant."""
        return set(re.findall(r"MUT_([A-Z_]+)", self.path.read_text(encoding="utf-8")))

    def check_holds(self, macros: str, folder: Path) -> None:
        """In no state anything is wrong, and every run ends."""
        self.build(folder, macros.split())
        assert self.verdict(folder, macros.split(), "-a") == ""

    def check_finds(self, mistake: str, macros: str, limits: str, folder: Path) -> None:
        """A mistake is found, and not by the bounds of the model itself, whose assertions begin with `limits`."""
        names = [*macros.split(), f"MUT_{mistake}"]
        self.build(folder, names, "-DSAFETY", "-DNOCLAIM")
        found = self.verdict(folder, names)
        assert re.match(r"assertion violated|invalid end state", found), found
        assert not re.match(rf"assertion violated \(({limits})", found), f"a limit of the model's own: {found}"

    def build(self, folder: Path, macros: Sequence[str], *options: str) -> None:
        """The verifier of a variant of the model, as `pan` in a folder."""
        run(["spin", *(f"-D{macro}" for macro in macros), "-a", str(self.path)], folder)
        run([*COMPILER, *options, f"-DMEMLIM={MEMORY_MB}", "-o", "pan", "pan.c"], folder)

    def verdict(self, folder: Path, macros: Sequence[str], *options: str) -> str:
        """What is wrong, with the trace that leads there; empty: all states were seen, and nothing is wrong."""
        report = run(["./pan", f"-m{DEPTH}", *options], folder)
        assert "max search depth too small" not in report, report
        found = re.search(r"^pan:1: (.*)$", report, re.MULTILINE)
        if not found:
            assert "errors: 0" in report, report
            assert "Search not completed" not in report, report
            return ""
        trail = f"{self.path.name}.trail"
        replay = ["spin", *(f"-D{macro}" for macro in macros), "-t", "-k", trail, str(self.path)]
        trace = [line for line in run(replay, folder).splitlines() if re.match(f" +({self.steps})", line)]
        return "\n".join([found.group(1), *trace])


def run(command: Sequence[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"
    return done.stdout
