"""Doors: processes of a launch link to those of their neighbours, and of the world."""

from __future__ import annotations

import fcntl
import os
import random
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.live import Live, until
from support.rosters import random_roster

from hierax.runtime.launch.doors import MOST_PATH_BYTES, Doors, doors_of, is_free
from hierax.schemas.roster import Roster


@pytest.fixture
def folder() -> Iterator[Path]:
    """With a short path."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        yield Path(name)


@pytest.mark.parametrize("seed", range(30))
def test_each_edge_and_each_way_to_the_world_is_one_link(seed: int, folder: Path) -> None:
    rng = random.Random(seed)
    roster = random_roster(rng)
    processes: dict[str, list[str]] = {}
    for name in sorted(roster.nodes):
        processes.setdefault(f"p{rng.randrange(4)}", []).append(name)
    doors = doors_of(roster, processes, folder)
    links = [frozenset((each.own, other)) for each in doors.values() for other in each.others]
    assert len(links) == len(set(links))
    assert set(links) == {frozenset(doors[name].own for name in pair) for pair in wanted(roster, processes)}


def wanted(roster: Roster, processes: dict[str, list[str]]) -> set[frozenset[str]]:
    """The processes between which there has to be a link."""
    home = {node: name for name, nodes in processes.items() for node in nodes}
    pairs = [*roster.pairs, *((roster.world, name) for name in roster.nodes)]
    return {pair for one, other in pairs if len(pair := frozenset((home[one], home[other]))) == 2}


def doors_in(folder: Path) -> dict[str, Doors]:
    roster = random_roster(random.Random(1))
    return doors_of(roster, {name: [name] for name in roster.nodes}, folder)


def test_there_are_none_where_the_folder_cannot_hold_sockets(folder: Path) -> None:
    assert doors_in(folder)
    assert os.listdir(folder) == []
    assert doors_in(folder / "missing") == {}
    for name in ("x" * (MOST_PATH_BYTES - len(f"{folder}/0.door")), "#", "a;b", "a b"):
        (folder / name).mkdir()
        assert doors_in(folder / name) == {}, name
    longest = folder / ("y" * (MOST_PATH_BYTES - len(f"{folder}//0.door")))
    longest.mkdir()
    assert doors_in(longest)


def test_those_of_a_launch_are_used(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    live = Live(tmp_path)
    try:
        live.goes_on()
        run = folder / "hierax" / "runs" / live.run["run"]
        heard = {path for line in Path("/proc/net/unix").read_text().splitlines() if (path := line.split()[-1])}
        assert {str(run / f"{number}.door") for number in range(len(live.run["nodes"]))} <= heard
    finally:
        live.close()


def test_a_door_whose_lock_is_held_or_whose_folder_is_gone_is_not_free(folder: Path) -> None:
    path = folder / "0.door"
    assert is_free(str(path))
    with open(f"{path}.lock", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert not is_free(str(path))
    assert is_free(str(path))
    assert not is_free(str(folder / "missing" / "0.door"))


def test_a_process_comes_back_without_its_door_where_somebody_holds_that(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    live = Live(tmp_path)
    try:
        live.goes_on()
        run = folder / "hierax" / "runs" / live.run["run"]
        (run / "0.door.lock").unlink()  # so that another lock can be taken in its place, before the process ends
        with open(run / "0.door.lock", "w", encoding="ascii") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            kill(live, "high")
            live.goes_on()
        live.is_repeated_by()
    finally:
        live.close()


def kill(live: Live, name: str) -> None:
    """Kill the process of a node, and wait for the one in its place."""
    pid = live.run["nodes"][name]["pid"]
    os.kill(pid, signal.SIGKILL)
    until(lambda: live.run["nodes"][name]["pid"] not in (None, pid), f"another process of {name}")
