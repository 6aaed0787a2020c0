"""What `docs/testing.md` shows works as shown, with the project that `hierax new` makes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from hierax.runtime.commands.new import make_project

DOCS = Path(__file__).parents[1] / "docs" / "testing.md"
NAMES = "from house import Room, Thermostat, reading\n"


def test_the_examples_pass(tmp_path: Path) -> None:
    folder = tmp_path / "house"
    make_project(folder)
    blocks = re.findall(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    shown = [block for block in blocks if "robot.mcap" not in block]  # testing/test_recorded_node.py has that
    assert len(blocks) == len(shown) + 1 == 5
    (folder / "test_docs.py").write_text(NAMES + "\n\n".join(shown), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider", "test_docs.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout
