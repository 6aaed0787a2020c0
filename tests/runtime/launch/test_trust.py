"""Nothing that is said to a launch makes it load code that its deployment file does not allow; whoever says it."""

from __future__ import annotations

import json
import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from support import stranger
from support.live import Live, environment, until

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.watch.run_folder import run_folder
from hierax.schemas.roster import Reference

MARKER = "hierax_test_marker"
TREACHERY = "support.treachery"
TIMEOUT_S = 120.0


@pytest.fixture
def user() -> Iterator[pwd.struct_passwd]:
    """A user of this test's own."""
    if os.getuid() != 0 or shutil.which("useradd") is None:
        pytest.skip("a user can be made by root only, with useradd")
    name = f"hx{os.getpid()}"
    made = subprocess.run(["useradd", "--no-create-home", name], capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"no user can be made here: {made.stderr.strip()}")
    try:
        yield pwd.getpwnam(name)
    finally:
        subprocess.run(["userdel", name], capture_output=True, check=False)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path)
    yield launch
    launch.close()


def references(folder: Path) -> dict[str, Reference]:
    """What a stranger would like to have run, and what would tell of it."""
    marker = folder / "imported"
    (folder / f"{MARKER}.py").write_text(f"from pathlib import Path\nPath({str(marker)!r}).touch()\n")
    (folder / "precious.txt").write_text("precious")
    touch = {"args": ["touch", str(folder / "ran")]}
    precious = {"path": str(folder / "precious.txt")}
    return {
        "module": Reference("subprocess:run", touch),
        "function": Reference("os:system", {"command": f"touch {folder / 'ran'}"}),
        "import": Reference(f"{MARKER}:X"),
        "walk": Reference("support.live_nodes:Gated.observe.__builtins__.update", {"x": 1}),
        "results": Reference("hierax.nodes.tracking.evaluation.probes:ResultsFile", {**precious, "scene_id": 0}),
        "class": Reference(f"{TREACHERY}:Writer", precious),
        "maker": Reference(f"{TREACHERY}:overwrite", precious),
    }


def refused(named: dict[str, Reference]) -> dict[str, str]:
    """By name, what a process says of it."""
    return {
        name: {
            "walk": f"one name in a module, got '{reference.target}'",
            "class": f", but {reference.target} is another class",
            "maker": f", but {reference.target} is a function; one that makes nodes says so",
        }.get(name, f"'{reference.target}' may not be loaded in this run")
        for name, reference in named.items()
    }


def is_untouched(folder: Path) -> bool:
    """Whether nothing of it was imported or called."""
    return (folder / "precious.txt").read_text() == "precious" and not any(
        (folder / name).exists() for name in ("imported", "ran")
    )


def said(run: str, node: str) -> str:
    """All that is in the log of a node, or of the launch."""
    return (run_folder(run) / "logs" / f"{node}.jsonl").read_text(encoding="utf-8")


def stranger_says(live: Live, user: pwd.struct_passwd, named: Iterable[Reference]) -> list[str]:
    """What another user's process is answered that names this code wherever it can."""
    order = {
        "user": user.pw_uid,
        "group": user.pw_gid,
        "endpoint": live.endpoint,
        "roster": read_deployment(live.file).roster.plain(),
        "references": [reference.plain() for reference in named],
    }
    path = live.folder / "order.json"
    path.write_text(json.dumps(order), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, stranger.__file__, str(path)],
        capture_output=True,
        text=True,
        env={**environment(live.folder), "HOME": str(live.folder)},
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["user"] == user.pw_uid
    refusals: list[str] = told["refusals"]
    return refusals


def test_what_another_user_names_is_neither_imported_nor_called(live: Live, user: pwd.struct_passwd) -> None:
    named = references(live.folder)
    foreign = [reference for reference in named.values() if not reference.target.startswith(TREACHERY)]
    refusals = stranger_says(live, user, foreign)
    assert len(refusals) == 6 * len(foreign)
    assert all("may not be loaded in this run" in each or "one name in a module" in each for each in refusals), refusals
    run = live.run["run"]
    words = refused(named)
    until(lambda: "refused Prepare" in said(run, "world"), "the world, which gets no orders")
    for node in ("low", "high"):
        for name, reference in named.items():
            if reference in foreign:
                until(lambda node=node, name=name: words[name] in said(run, node), f"{node} refuses {name}")
    live.goes_on()
    assert is_untouched(live.folder)
    top = live.snippet("top", "high")
    live.is_repeated_by(f"{live.change('attach', top)}:attach:{top}")
    told = "a change is refused: nodes.thief.class: 'os:system' may not be loaded"
    assert told in "".join(live.launch.err)
    assert told in said(run, "_launch")
    assert is_untouched(live.folder)
