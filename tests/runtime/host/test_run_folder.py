from __future__ import annotations

import os
from pathlib import Path

import pytest

from hierax.runtime.host.private_files import shown_alive
from hierax.runtime.host.run_folder import (
    ALIVE,
    KEPT_RUNS,
    begin_run,
    is_alive,
    is_process,
    known_folders,
    meant,
    run_folder,
    runs_folder,
)

NO_PROCESS = 2**22 - 1


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def begin(number: int, pid: int = NO_PROCESS) -> Path:
    folder = begin_run(f"{number:08x}", {"pid": pid})
    os.utime(folder / "about.json", (number, number))
    return folder


def test_folders_are_where_logs_belong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert runs_folder() == tmp_path / "hierax" / "runs"
    for nowhere in ("", "relative"):
        monkeypatch.setenv("XDG_STATE_HOME", nowhere)
        assert runs_folder() == Path.home() / ".local" / "state" / "hierax" / "runs"


def test_the_youngest_is_the_first() -> None:
    made = [begin(number) for number in (1, 3, 2)]
    assert known_folders() == [made[1], made[2], made[0]]


def test_old_ones_go_but_not_those_that_run() -> None:
    alive = begin(1, os.getpid())
    for number in range(2, KEPT_RUNS + 4):
        begin(number)
    begin_run("last", {"pid": os.getpid()})
    left = known_folders()
    assert len(left) == KEPT_RUNS + 1
    assert left[0] == run_folder("last")
    assert left[-1] == alive


@pytest.mark.parametrize(("about", "alive"), [('{"pid": -1}', False), ("torn {", False), ('{"pid": "x"}', False)])
def test_what_cannot_be_read_is_over(about: str, alive: bool) -> None:
    folder = begin(1)
    (folder / "about.json").write_text(about)
    assert is_alive(folder) is alive


def test_a_launch_is_alive_by_its_lock_and_not_by_the_number_of_its_process() -> None:
    elsewhere, reused = begin(1), begin(2, os.getpid())
    alive = shown_alive(elsewhere / ALIVE)
    os.close(shown_alive(reused / ALIVE))
    assert (is_alive(elsewhere), is_alive(reused)) == (True, False)
    for number in range(3, KEPT_RUNS + 4):
        begin(number)
    assert (elsewhere.exists(), reused.exists()) == (True, False)
    os.close(alive)
    assert not is_alive(elsewhere)


@pytest.mark.parametrize(
    ("which", "found"),
    [("ab12", ["ab12"]), ("servo", ["ab12", "cd34"]), ("cd", ["ab99"]), ("ab", ["ab12", "ab99"]), ("", []), ("no", [])],
)
def test_a_launch_is_meant_by_its_identification_its_hierarchy_or_a_beginning(which: str, found: list[str]) -> None:
    runs = [("ab12", "servo"), ("cd34", "servo"), ("ab99", "cd")]
    assert [run for run, _ in meant(which, runs, lambda each: each)] == found


def test_only_a_process_that_is_there_is_one() -> None:
    assert is_process(os.getpid())
    assert not is_process(NO_PROCESS)
