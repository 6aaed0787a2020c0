"""Nothing that is said to a launch makes it load code that its deployment file does not allow; whoever says it."""

from __future__ import annotations

import json
import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from support import stranger
from support.deployments import replaced, write
from support.live import Live, environment, until

from hierax.runtime.commands.main import main
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.host.run_folder import NOT_OURS, run_folder
from hierax.runtime.launch.orders import LaunchOptions, Orders
from hierax.runtime.launch.run_file import read_run
from hierax.runtime.loading.allowance import NotAllowedError
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.schemas.checkpoint import WorldRecord, encode_world
from hierax.schemas.roster import Reference
from hierax.schemas.values import encode_value

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
        "secret": live.secret,
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


# --- folders of runs


def state_of(folder: Path) -> tuple[Path, Orders]:
    """The folder of a run that was begun, and what makes its orders."""
    file = folder / "toys.yaml"
    write(folder)
    deployment = read_deployment(file)
    state = folder / "state"
    state.mkdir(mode=0o700)
    orders = Orders(deployment, "5163af85", "", LaunchOptions(3, 9, state))
    orders.save()
    return state, orders


def test_a_folder_that_was_edited_is_refused_without_trust(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state, _ = state_of(tmp_path)
    assert read_run(state).seed == 3
    path = state / "run.json"
    written = json.loads(path.read_text())
    edits = {"deployment": str(tmp_path / "theirs.yaml"), "settings": ["nodes.left.class=subprocess:run"], "seed": 4}
    for field, value in {**edits, "seal": "0" * 64}.items():
        path.write_text(json.dumps({**written, field: value}))
        assert main(["launch", "--resume", str(state)]) == 1
        out, err = capsys.readouterr()
        assert (out, err) == ("", f"error: {path}: {NOT_OURS}\n")
    path.write_text(json.dumps({name: value for name, value in written.items() if name != "seal"}))
    with pytest.raises(HieraxError, match="--trust loads and runs what it names"):
        read_run(state)
    assert read_run(state, trust=True).deployment == written["deployment"]


def test_a_folder_of_another_user_or_machine_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state, _ = state_of(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    with pytest.raises(HieraxError, match="--trust loads and runs what it names"):
        read_run(state)


def test_the_worlds_record_names_no_code_that_the_deployment_does_not(tmp_path: Path) -> None:
    state, begun = state_of(tmp_path)
    orders = Orders(begun.deployment, "5163af86", "", begun.options, read_run(state))
    roster = orders.deployment.roster
    for changed in (roster, replace(roster, nodes={**roster.nodes, "left": Reference("subprocess:run")})):
        storage = MappedFile(state / "world", "process")
        belief = encode_value((0, "", ()))
        record = WorldRecord(1, 0, 0, encode_value(changed.plain()), 0, bytes(32), belief)
        for _ in range(2):
            Slots(storage).write(encode_world(record))
        storage.close()
        if changed is roster:
            assert orders.roster() == roster
            continue
        with pytest.raises(NotAllowedError, match=r"^nodes\.left\.class: 'subprocess:run' may not be loaded"):
            orders.roster()


def test_trust_is_for_what_is_resumed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["launch", "servo", "--trust"]) == 1
    assert "--trust: only with --resume" in capsys.readouterr().err


# --- what is validated


def test_validating_calls_nothing_that_is_no_node(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for target in ("subprocess:run", "shutil:rmtree", "builtins:exec", f"{TREACHERY}:overwrite"):
        path = write(tmp_path, replaced("class: support.toy_nodes:Counter", f"class: {target}"))
        assert main(["validate", str(path)]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert f"nodes.world.class: expected a class derived from World, but {target} is" in err
