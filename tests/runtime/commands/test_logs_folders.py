from __future__ import annotations

import json
import os
import re
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

from hierax.runtime.commands.logs import LogFilter, Reader, find_folder, line, read_pattern, read_since
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_folder import begin_run, known_folders

NOW = datetime(2030, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
NO_PROCESS = 2**22 - 1


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def begin(run: str, number: int, pid: int = NO_PROCESS) -> Path:
    folder = begin_run(run, {"pid": pid})
    os.utime(folder / "about.json", (number, number))
    return folder


def entry(second: int, node: str = "arm", **change: Any) -> dict[str, Any]:
    time = (NOW + timedelta(seconds=second)).isoformat().replace("+00:00", "Z")
    return {"time": time, "level": "INFO", "node": node, "epoch": 3, "message": f"{node} {second}", **change}


def write(folder: Path, name: str, *entries: dict[str, Any], end: str = "\n") -> Path:
    path = folder / "logs" / name
    with path.open("a", encoding="utf-8") as file:
        file.write("".join(json.dumps(each) + "\n" for each in entries)[:-1] + end)
    return path


def test_the_youngest_that_runs_is_meant(tmp_path: Path) -> None:
    with pytest.raises(HieraxError, match="no launch has left a log"):
        find_folder(None)
    begin("aaaa1111", 1)
    runs = begin("bbbb2222", 2, os.getpid())
    last = begin("cccc3333", 3)
    assert find_folder(None) == runs
    assert find_folder("cccc3333") == last
    with pytest.raises(HieraxError, match="no log of a launch 'cccc3334'; did you mean 'cccc3333'"):
        find_folder("cccc3334")


def test_entries_of_all_files_come_in_order_of_time() -> None:
    folder = begin("aa", 1)
    write(folder, "arm.jsonl", entry(1), entry(5))
    write(folder, "world.jsonl", entry(2, "world"), entry(4, "world"))
    reader = Reader(folder)
    assert [each["message"] for each in reader.read()] == ["arm 1", "world 2", "world 4", "arm 5"]
    assert reader.names == ["arm", "world"]
    assert reader.read() == []


def test_what_is_written_meanwhile_is_read_once_and_whole() -> None:
    folder = begin("aa", 1)
    path = write(folder, "arm.jsonl", entry(1), entry(2), end="")  # the last line has no end yet
    reader = Reader(folder)
    assert [each["message"] for each in reader.read()] == ["arm 1"]
    with path.open("a") as file:
        file.write("\nnonsense\n[1]\n")
    write(folder, "arm.jsonl", entry(3))
    assert [each["message"] for each in reader.read()] == ["arm 2", "arm 3"]


def test_a_file_that_is_put_aside_is_read_to_its_end() -> None:
    folder = begin("aa", 1)
    path = write(folder, "arm.jsonl", entry(1))
    reader = Reader(folder)
    reader.read()
    write(folder, "arm.jsonl", entry(2))
    path.rename(path.with_name("arm.jsonl.1"))
    write(folder, "arm.jsonl", entry(3))
    assert [each["message"] for each in reader.read()] == ["arm 2", "arm 3"]


@pytest.mark.parametrize(
    ("log_filter", "seconds"),
    [
        (LogFilter(), [1, 2, 3, 4]),
        (LogFilter(nodes=("world",)), [2]),
        (LogFilter(level="WARNING"), [3, 4]),
        (LogFilter(since=NOW + timedelta(seconds=3)), [3, 4]),
        (LogFilter(pattern=re.compile("slip+ed|KeyError")), [3, 4]),
        (LogFilter(nodes=("arm", "world"), level="ERROR"), [4]),
    ],
)
def test_filters(log_filter: LogFilter, seconds: list[int]) -> None:
    entries = [
        entry(1),
        entry(2, "world"),
        entry(3, level="WARNING", message="slipped"),
        entry(4, level="ERROR", exception="Traceback\nKeyError: 3"),
    ]
    assert [entries.index(each) + 1 for each in filter(log_filter, entries)] == seconds


@pytest.mark.parametrize(
    ("text", "ago_s"),
    [("30s", 30), ("10m", 600), ("1.5h", 5400), ("2 d", 172800), ("2030-01-02T03:04:00+00:00", 5)],
)
def test_points_in_time(text: str, ago_s: float) -> None:
    assert read_since(text, NOW) == NOW - timedelta(seconds=ago_s)


def test_what_is_no_time_and_no_pattern_is_told() -> None:
    with pytest.raises(HieraxError, match="--since: expected how long ago, such as 10m"):
        read_since("yesterday", NOW)
    with pytest.raises(HieraxError, match="--grep: '\\(' is no regular expression"):
        read_pattern("(")


def test_where_one_may_not_enter_no_launch_has_left_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", f"/{'x' * 300}")  # raises as such a folder does, for root, too
    assert known_folders() == []


def test_an_entry_as_text() -> None:
    text = line(entry(1, level="ERROR", exception="Traceback\nKeyError: 3"))
    assert re.fullmatch(r"\d\d:04:06\.000 ERROR arm epoch 3: arm 1\nTraceback\nKeyError: 3", text)
