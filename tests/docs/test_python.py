"""What the pages on Python show works as shown."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import nbclient
import nbformat
import pytest

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "python.md").read_text("utf-8"), re.DOTALL)
    assert len(blocks) == 2
    script = blocks[0] + "\nif __name__ == '__main__':\n" + re.sub("^", "    ", blocks[1], flags=re.MULTILINE)
    (tmp_path / "page.py").write_text(script, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "page.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 60


# Jupyter's client leaves sockets to be closed by the collector of garbage, and warns of a loop that is not Proactor's.
@pytest.mark.filterwarnings("ignore")
def test_the_notebook(tmp_path: Path) -> None:
    notebook = nbformat.read(DOCS / "python.ipynb", as_version=4)
    nbformat.validate(notebook)
    nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    printed = [[each for each in cell.get("outputs", ()) if each.get("name") == "stdout"] for cell in notebook.cells]
    texts = ["".join(each["text"] for each in cell) for cell in printed]  # what processes say goes to stderr
    results = [
        each["data"]["text/plain"]
        for cell in notebook.cells
        for each in cell.get("outputs", ())
        if each["output_type"] == "execute_result"
    ]
    with_context, without = (float(re.findall(r"\d\.[\d.e-]+", each)[0]) for each in results[:2])
    assert without > 10 * with_context
    assert results[2].startswith("(60, ")
    assert "True\n" in texts
    assert texts[-1].startswith("hierarchy: servo\n")
