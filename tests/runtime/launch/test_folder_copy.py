"""A deployment's folder is copied to hosts behind a stand-in for `ssh`, which runs what it is told on this machine."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from support.far_hosts import script
from support.live import hierax

from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.launch.folder_copy import copied
from hierax.runtime.launch.keeper_link import HostError

STAND_IN = (
    'while [ "$1" != -- ]; do shift; done',
    "shift 2",  # the destination
    'cd "$THERE" && HOME="$THERE" exec sh -c "$*"',
)
FILE = """\
hierarchy: copied
world: world
hosts: {robot: {ssh: "-p 2222 pi@robot", folder: ~/its new/place}}
place: {world: robot}
nodes: {world: {class: "hierax.nodes.letters:SymbolWorld"}}
"""

pytestmark = pytest.mark.skipif(shutil.which("rsync") is None, reason="folders are copied by `rsync`, which is missing")


@pytest.fixture(autouse=True)
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The host's home."""
    for name in ("bin", "there", "here"):
        (tmp_path / name).mkdir()
    script(tmp_path / "bin" / "ssh", STAND_IN)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    monkeypatch.setenv("THERE", str(tmp_path / "there"))
    return tmp_path / "there"


@pytest.fixture
def place(there: Path) -> Path:
    """Where the folder goes to."""
    return there / "its new" / "place"


@pytest.fixture
def deployment(tmp_path: Path) -> Deployment:
    """In a folder with modules of its own."""
    file = tmp_path / "here" / "copied.yaml"
    file.write_text(FILE, encoding="utf-8")
    write(file.parent, {"own.py": "one", "package/__init__.py": "", "data/a table.csv": "1,2"})
    return read_deployment(str(file))


def write(folder: Path, texts: dict[str, str]) -> None:
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def read(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_text(encoding="utf-8") for path in files}


def copy(deployment: Deployment, *own: Path) -> Deployment:
    return copied(deployment, own, lambda what: None)


def refusal(deployment: Deployment) -> str:
    with pytest.raises(HostError) as caught:
        copy(deployment)
    return str(caught.value)


def test_the_folder_is_there_as_it_is_here(deployment: Deployment, place: Path) -> None:
    told: list[str] = []
    here = deployment.path.parent
    assert copied(deployment, (), told.append).hosts == deployment.hosts
    assert read(place) == read(here)
    assert told == [f"host robot has a copy of {here} in ~/its new/place"]


def test_what_has_changed_here_is_copied_again_and_nothing_is_deleted_there(
    deployment: Deployment, place: Path
) -> None:
    copy(deployment)
    here = deployment.path.parent
    (here / "data" / "a table.csv").unlink()
    write(here, {"own.py": "two"})
    write(place, {"its own.py": "three", "package/other.py": "four"})
    copy(deployment)
    expected = {"own.py": "two", "data/a table.csv": "1,2", "its own.py": "three", "package/other.py": "four"}
    assert read(place) == {**read(here), **expected}


def test_what_others_make_and_launches_write_is_left_out(
    deployment: Deployment, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = deployment.path.parent
    kept = read(here)
    monkeypatch.setenv("XDG_STATE_HOME", str(here / "local"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(here / "runtime"))
    state, record = here / "run [1]*\\", here / "runs" / "last.mcap"
    made = [".git/config", "package/.git", ".venv/bin/python", "__pycache__/own.pyc", "package/__pycache__/a.pyc"]
    made += ["local/hierax/key", "local/hierax/runs/r/logs/low.jsonl", "runtime/hierax/r.key", "run [1]*\\/low.0"]
    write(here, dict.fromkeys([*made, "runs/last.mcap"], "not for others"))
    write(here, {"runs/other.mcap": "kept", "run 1/low.0": "kept"})
    copy(deployment, state, record)
    assert read(place) == {**kept, "runs/other.mcap": "kept", "run 1/low.0": "kept"}


def test_nothing_outside_of_the_copy_is_touched(deployment: Deployment, there: Path, place: Path) -> None:
    here = deployment.path.parent
    write(there, {"outside/a table.csv": "precious", "outside/own.py": "precious"})
    place.mkdir(parents=True, mode=0o700)
    (place / "data").symlink_to(there / "outside")
    (place / "own.py").symlink_to(there / "outside" / "own.py")
    (here / "link").symlink_to("/etc")
    here.chmod(0o777)
    copy(deployment)
    assert read(there / "outside") == {"a table.csv": "precious", "own.py": "precious"}
    assert (place / "own.py").read_text() == "one"
    assert not (place / "data").is_symlink()
    assert os.readlink(place / "link") == "/etc"
    assert place.stat().st_mode & 0o777 == 0o700, "a folder that was there is open to others"


def test_without_a_folder_it_is_at_the_same_path_there(deployment: Deployment, tmp_path: Path) -> None:
    host = replace(deployment.hosts["robot"], folder="")
    # this machine is its own host: what was copied there already is left as it is
    done = copy(replace(deployment, hosts={"robot": host}))
    assert done.hosts["robot"].folder == str(tmp_path / "here")


def test_an_rsync_that_is_not_here(deployment: Deployment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    said = refusal(deployment)
    assert said.startswith("hosts.robot: `rsync` cannot be started here: No such file or directory; expected "), said
    assert said.endswith("by `rsync`, on both machines (--sync)"), said


def test_an_rsync_that_is_not_there(deployment: Deployment, tmp_path: Path) -> None:
    (tmp_path / "few").mkdir()
    for name in ("sh", "env", "mkdir"):
        (tmp_path / "few" / name).symlink_to(str(shutil.which(name)))
    script(tmp_path / "bin" / "ssh", (*STAND_IN[:2], f"export PATH={tmp_path / 'few'}", STAND_IN[2]))
    said = refusal(deployment)
    assert said.startswith("hosts.robot: there is no `rsync` there; expected "), said


def test_a_folder_that_cannot_be_made_there(deployment: Deployment, there: Path) -> None:
    write(there, {"its new": "a file"})
    said = refusal(deployment)
    assert said.startswith("hosts.robot: `rsync` has failed (exit code "), said
    assert "its new" in said.partition("; expected ")[0], said
    assert f"expected {deployment.path.parent} to be copied to ~/its new/place there" in said


def test_a_host_that_is_not_reached(deployment: Deployment, tmp_path: Path) -> None:
    script(tmp_path / "bin" / "ssh", ("echo 'ssh: connect to host robot: Connection refused' >&2", "exit 255"))
    expected = "expected `ssh -p 2222 pi@robot` to log in without a question"
    assert refusal(deployment) == (
        f"hosts.robot: cannot be reached: ssh: connect to host robot: Connection refused; {expected}"
    )


def said_of(folder: Path, *arguments: str) -> str:
    """The line that a launch is refused with."""
    done = hierax(folder, "launch", *arguments, "--sync")
    assert done.returncode == 1, done
    (line,) = done.stderr.splitlines()
    return line


def test_what_there_is_nothing_to_copy_of_is_refused(
    deployment: Deployment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = said_of(tmp_path, "letters")
    assert said.endswith("comes with hierax, which every host has of its own; " + EXPECTED), said
    file = deployment.path
    said = said_of(tmp_path, str(file), "--set", "place={}")
    assert said == f"error: --sync: no node of {file} is placed on a host that is reached by ssh"
    monkeypatch.setenv("HOME", str(file.parent))
    said = said_of(tmp_path, str(file))
    assert said == f"error: --sync: {file} is in {file.parent}, all of which would be copied; {EXPECTED}"


EXPECTED = "expected a deployment file in a folder of its own"
