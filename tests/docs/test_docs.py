"""What the pages show works as shown: their commands are run, page by page, in the order in which they stand.

In a page, a block `console` holds commands behind `$ `; what else stands in it is output. A block with a title is
a file: ``title="NAME"`` makes it, ``title="at the end of NAME"`` adds to it. A page is run by one shell in an empty
folder.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted(DOCS.glob("*.md")))
}
FENCE = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```', re.DOTALL | re.MULTILINE)
ADDED = "at the end of "
TIMEOUT_S = 240

LONG = ("make ", "apt-get ", ".venv/bin/", "spin ", "python benchmarks/")
"""Set-up, and what takes minutes; each `make` target and script has tests of its own."""


def script(text: str) -> str:
    """All commands and files of a page, for bash."""
    lines = ["set -e"]
    for language, title, body in FENCE.findall(text):
        if language == "console":
            lines += [line[2:] for line in body.splitlines() if line.startswith("$ ")]
        elif title:
            name = title.removeprefix(ADDED)
            lines.append(f"cat {'>>' if title.startswith(ADDED) else '>'} {name} << 'END_OF_FILE'\n{body}END_OF_FILE")
    return "\n".join(lines) + "\n"


RUN = [page for page, text in PAGES.items() if "```console" in text]


def test_there_are_pages_to_run() -> None:
    assert "docs/tutorial.md" in RUN


@pytest.mark.parametrize("page", RUN)
def test_the_commands_of_a_page_work(page: str, tmp_path: Path) -> None:
    folder, state = tmp_path / "work", tmp_path / "state"
    for each in (folder, state):
        each.mkdir()
    tools = str(Path(sys.executable).parent)
    environment = {
        **os.environ,
        "PATH": tools + os.pathsep + os.environ["PATH"],
        "XDG_RUNTIME_DIR": str(state),
        "XDG_STATE_HOME": str(state),
        "COLUMNS": "120",
    }
    written = tmp_path / "output.txt"
    with written.open("wb") as output:
        done = subprocess.run(
            ["bash", "-m", "-x", "-c", script(PAGES[page])],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            timeout=TIMEOUT_S,
            check=False,
        )
    assert done.returncode == 0, written.read_text(encoding="utf-8", errors="replace")[-4000:]


@pytest.mark.parametrize("page", PAGES)
def test_no_command_stands_where_it_is_not_run(page: str) -> None:
    for language, _, body in FENCE.findall(PAGES[page]):
        if language == "console":
            continue
        for line in body.splitlines():
            command = line.removeprefix("$ ")
            assert not re.match(r"(\w+=\S+ )*(hierax|pytest|python) ", command) or command.startswith(LONG), line


def test_every_make_target_that_is_named_exists() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for page, text in PAGES.items():
        for target in re.findall(r"(?:`|^)make (\w+)", text, re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"{page}: make {target}"


def test_every_script_that_is_named_exists() -> None:
    for page, text in PAGES.items():
        for name in re.findall(r"benchmarks/\w+(?:/\w+)?\.(?:py|cpp)", text):
            assert (ROOT / name).is_file(), f"{page}: {name}"


def test_every_decision_is_in_the_list() -> None:
    index = (DOCS / "decisions" / "index.md").read_text(encoding="utf-8")
    for path in sorted((DOCS / "decisions").glob("0*.md")):
        title = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
        assert f"- [{title}]({path.name})" in index
