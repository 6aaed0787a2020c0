"""The model of the protocol holds, and each of its mistakes is found; docs/model.md says what is modelled."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from support.sweep import SWEEP

MODEL = Path(__file__).with_name("epochs.pml")
LIMIT_S = 300
DEPTH = 5000
MEMORY_MB = 4000

# What one verifier of many computes is little; it is compiled in a thirtieth of the time where tcc is there.
COMPILER = ["gcc", "-O1"] if SWEEP else [shutil.which("tcc") or "gcc", "-O0"]

pytestmark = pytest.mark.skipif(
    not (shutil.which("spin") and shutil.which("gcc")), reason="spin or gcc is not there; `make model` installs spin"
)

SOUND = {
    "attach": "ATTACH REDOS=1",
    "diamond, attach": "DIAMOND ATTACH",
    "two crashes": "CRASHES=2",
    "damage, replace": "DAMAGE REPLACE",
}
FURTHER = {
    "redo": "REDOS=1",
    "replace": "REPLACE REDOS=1",
    "diamond": "DIAMOND REDOS=1",
    "diamond, replace": "DIAMOND REPLACE",
    "damage": "DAMAGE REDOS=1",
    "damage, attach": "DAMAGE ATTACH",
}
"""Those that `make model` goes through besides."""

MISTAKES = {
    "STALE_ATTEMPT": "REDOS=1",
    "ATTEMPT_REUSED": "",
    "SINGLE_PHASE": "ATTACH",
    "VERSION_REUSED": "ATTACH",
    "IGNORE_INSTANCE": "REPLACE",
    "WRONG_ROLLBACK": "",
    "WRONG_START": "",
    "NODE_COMMITS": "",
    "COMMIT_EARLY": "",
    "RECORD_LATE": "",
    "CHECKPOINT_LATE": "",
    "CHECKPOINT_SKIPPED": "",
    "HANDOVER_MIDWAY": "REPLACE",
    "HANDOVER_NOT_SAVED": "REPLACE",
    "DISMISSED_EARLY": "REPLACE",
    "JOIN_WITHOUT_CHECKPOINT": "DAMAGE",
    "JOIN_CHECKED_ONCE": "DAMAGE",
    "JOIN_ANY_ATTEMPT": "DAMAGE REDOS=1",
}


def run(command: Sequence[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"
    return done.stdout


def build(folder: Path, macros: Sequence[str], *options: str) -> None:
    """The verifier of a variant of the model, as `pan` in a folder."""
    run(["spin", *(f"-D{macro}" for macro in macros), "-a", str(MODEL)], folder)
    run([*COMPILER, *options, f"-DMEMLIM={MEMORY_MB}", "-o", "pan", "pan.c"], folder)


def verdict(folder: Path, macros: Sequence[str], *options: str) -> str:
    """What is wrong, with the trace that leads there; empty: all states were seen, and nothing is wrong."""
    report = run(["./pan", f"-m{DEPTH}", *options], folder)
    assert "max search depth too small" not in report, report
    found = re.search(r"^pan:1: (.*)$", report, re.MULTILINE)
    if not found:
        assert "errors: 0" in report, report
        assert "Search not completed" not in report, report
        return ""
    replay = ["spin", *(f"-D{macro}" for macro in macros), "-t", "-k", f"{MODEL.name}.trail", str(MODEL)]
    trace = [line for line in run(replay, folder).splitlines() if re.match(r" +(\d|world|owner|refused)", line)]
    return "\n".join([found.group(1), *trace])


@pytest.mark.parametrize("macros", [*SOUND.values(), *(FURTHER.values() if SWEEP else ())])
def test_the_protocol_holds_and_every_run_ends(macros: str, tmp_path: Path) -> None:
    build(tmp_path, macros.split())
    assert verdict(tmp_path, macros.split(), "-a") == ""


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found(mistake: str, tmp_path: Path) -> None:
    macros = [*MISTAKES[mistake].split(), f"MUT_{mistake}"]
    assert macros[-1] in MODEL.read_text(encoding="utf-8")
    build(tmp_path, macros, "-DSAFETY", "-DNOCLAIM")
    found = verdict(tmp_path, macros)
    assert re.match(r"assertion violated|invalid end state", found), found
    assert not re.match(r"assertion violated \((filled\[|plan<)", found), f"a limit of the model's own: {found}"


def test_a_deadlock_is_a_run_that_does_not_end(tmp_path: Path) -> None:
    macros = ["MUT_SINGLE_PHASE"]
    build(tmp_path, macros)
    assert verdict(tmp_path, macros, "-a").startswith("acceptance cycle")


def test_every_mistake_of_the_model_is_tried() -> None:
    assert set(re.findall(r"MUT_([A-Z_]+)", MODEL.read_text(encoding="utf-8"))) == MISTAKES.keys()
