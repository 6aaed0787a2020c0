"""What the pages show works as shown: their commands are run, page by page, in the order in which they stand."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.pages import FENCE, beginnings, script
from support.reader import environment_of

from hierax.runtime.core.hierarchy import Edge
from hierax.runtime.testing.node import check_node
from hierax.runtime.testing.runs import run_hierarchy

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted(DOCS.glob("*.md")))
}
TIMEOUT_S = 600

LONG = ("make ", "apt-get ", ".venv/bin/", "spin ", "python benchmarks/")
"""Set-up, and what takes minutes; each `make` target and script has tests of its own."""


LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")
RUN = [page for page, text in PAGES.items() if "```console" in text]
TUTORIAL = "docs/tutorial.md"
"""Run as its reader does, with no more installed than it says."""


def test_links_between_pages_lead_somewhere() -> None:
    pages = {path: path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))}
    links = [
        (page.relative_to(ROOT).as_posix(), link)
        for page, text in pages.items()
        for link in LINK.findall(re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL))
        if "://" not in link and not (page.parent / link).exists()
    ]
    assert not links


def test_the_modules_of_the_reference_are_there() -> None:
    named = [
        name
        for page in sorted(DOCS.glob("reference/*.md"))
        for name in re.findall(r"^::: (\S+)", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert named
    assert not [name for name in named if importlib.util.find_spec(name) is None]


def test_the_page_of_the_deployment_file_has_all_fields_and_their_words() -> None:
    schema = json.loads((ROOT / "runtime/deployment/deployment.schema.json").read_text(encoding="utf-8"))
    models = [schema, *(model for model in schema["$defs"].values() if "properties" in model)]
    fields = [(name, field) for model in models for name, field in model["properties"].items()]
    words = {word for _, field in fields for each in field.get("anyOf", ()) for word in each.get("enum", ())}
    page = re.sub(r"```.*?```", "", PAGES["docs/deployment.md"], flags=re.DOTALL)
    shown = set(re.findall(r"[\w-]+", " ".join(re.findall(r"`[^`]+`", page))))
    recovery = set(re.findall(r"`([\w-]+)`", PAGES["docs/recovery.md"]))
    assert {name for name, _ in fields} - shown == set()
    assert words - shown - recovery == set()


def test_the_robot_of_the_page_on_nodes_drives_as_fast_as_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("driving", "robot"):
        code = re.search(rf'```python title="{name}\.py"\n(.*?)```', PAGES["docs/nodes.md"], re.DOTALL)
        assert code is not None
        (tmp_path / f"{name}.py").write_text(code[1], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    driving, robot = importlib.import_module("driving"), importlib.import_module("robot")
    driven: list[float] = []

    class Device:
        def __init__(self, name: str) -> None:
            self.range_m = lambda: 1.0
            self.drive = driven.append

    monkeypatch.setattr(robot, "Device", Device, raising=False)
    edges = [Edge("robot", "pilot", sense=lambda belief: (0.75,), task=driving.wanted)]
    ran = run_hierarchy({"robot": robot.Robot("range"), "pilot": driving.Pilot()}, edges, world="robot", epochs=2)
    assert ran.steps["robot"][-1].policy == "drive 0.25"
    assert ran.steps["robot"][-1].actions == ({"m_s": 0.25},)
    assert driven == [0.25, 0.25]
    check_node(driving.Cart, tasks=[({"m_s": 0.1 + 0.2},), ()])


def test_there_are_pages_to_run() -> None:
    assert TUTORIAL in RUN


@pytest.mark.parametrize("page", [page for page in RUN if page != TUTORIAL])
def test_the_commands_of_a_page_work(page: str, tmp_path: Path) -> None:
    run_page(page, tmp_path, Path(sys.executable).parent)


def installed() -> list[list[str]]:
    """What the tutorial's readers have, by how they begin: what `make demo` installs, or pip, and what they add."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    recipe = re.search(r"^\$\(RUNS\):.*?\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert recipe is not None
    demo = ["hierax" + extras for extras in re.findall(r'--editable "?\.(\[[a-z,]+\])?"?$', recipe[1], re.MULTILINE)]
    found = []
    for lines in beginnings(PAGES[TUTORIAL]):
        words = [shlex.split(line) for line in lines]
        added = [word for line in words if line[:2] == ["pip", "install"] for word in line[2:]]
        found.append((demo if ["make", "demo"] in words else []) + added)
    return found


def test_the_tutorial_has_two_beginnings_that_install_the_same() -> None:
    demo, pip = installed()
    assert sorted(demo) == sorted(pip) == ["hierax[record]", "pytest"]


def test_the_tutorial_works_with_what_its_reader_has(tmp_path: Path) -> None:
    has = environment_of(installed()[0], tmp_path / "reader")
    found = subprocess.run([has / "python", "-c", "import rerun"], capture_output=True, check=False)
    assert found.returncode, "the reader has more than was asked for"
    run_page(TUTORIAL, tmp_path, has)


def test_without_the_package_for_recordings_commands_say_how_to_get_it(tmp_path: Path) -> None:
    has = environment_of(["hierax"], tmp_path / "reader")
    for arguments in (
        ("run", "letters", "--record", "x.mcap"),
        ("launch", "letters", "--record", "x.mcap"),
        ("record", "letters", "-o", "x.mcap"),
        ("replay", "x.mcap"),
        ("check", "x.mcap"),
        ("diff", "x.mcap", "x.mcap"),
    ):
        (tmp_path / "x.mcap").touch()
        done = subprocess.run(
            [has / "hierax", *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert done.returncode == 1, arguments
        assert done.stderr == "error: recordings need the package mcap: pip install 'hierax[record]'\n", arguments


PACED = 'probes=[{{node: {}, class: "support.pace:Pace"}}]'
WORLDS = {"*.yaml*": "room", "*": "world"}
"""The world's name, by how a launch is called: that of the tutorial's file, and of all that is shipped."""


def gentle(programs: Path, folder: Path) -> Path:
    """A folder with a `hierax` whose endless launches wait in each epoch, and leave the processor to what goes on
    beside.
    """
    tools = folder / "tools"
    tools.mkdir()
    program = tools / "hierax"
    real, tests = f'exec "{programs}/hierax" "$@"', shlex.quote(str(ROOT / "tests"))
    endless = "".join(
        f'launch{called}" --epochs 1000000"*) PYTHONPATH={tests} {real} --set {shlex.quote(PACED.format(world))};; '
        for called, world in WORLDS.items()
    )
    program.write_text(f'#!/bin/sh\ncase "$*" in {endless}esac\n{real}\n')
    program.chmod(0o755)
    return tools


def run_page(page: str, tmp_path: Path, programs: Path) -> None:
    """Run a page's commands, with the programs of a Python environment."""
    folder, state = tmp_path / "work", tmp_path / "state"
    for each in (folder, state):
        each.mkdir()
    tools = f"{gentle(programs, tmp_path)}{os.pathsep}{programs}"
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


def test_no_page_waits_in_a_loop() -> None:
    for page, text in PAGES.items():
        assert not re.search(r"\b(until|while) .*; do\b", script(text)), f"{page}: what is waited for may never come"


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
