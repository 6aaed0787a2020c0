from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hierax.runtime.host.run_folder import ABOUT, run_folder
from hierax.runtime.watch import logs
from hierax.runtime.watch.logs import QUIET, JsonLine, begin_log, log_console, log_nodes, log_of_run, open_log


@pytest.fixture(autouse=True)
def fresh_logging(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Logging as in a process that has just begun, and afterwards as it was."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    root, make = logging.getLogger(), logging.getLogRecordFactory()
    handlers, level = root.handlers[:], root.level
    root.handlers[:] = []
    yield
    for handler in root.handlers:
        handler.close()
    root.handlers[:] = handlers
    root.setLevel(level)
    logging.setLogRecordFactory(make)


def entries(run: str, name: str) -> list[dict[str, Any]]:
    path = run_folder(run) / "logs" / f"{name}.jsonl"
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_a_nodes_records_have_run_node_and_epoch(capsys: pytest.CaptureFixture[str]) -> None:
    when = (0, 0)
    log_console()
    log_nodes("5163af85", "arm", {"arm": lambda: when})
    logger = logging.getLogger("robots.arm")
    logger.info("calibrated")
    when = (12, 1)
    logger.warning("slipped by %.1f mm", 2.5, extra={"joint": 3})
    logger.debug("not even in the file")
    first, second = entries("5163af85", "arm")
    assert first["message"] == "calibrated"
    where = {"run": "5163af85", "node": "arm", "epoch": 12, "attempt": 1, "logger": "robots.arm", "level": "WARNING"}
    assert second == {**where, "time": second["time"], "message": "slipped by 2.5 mm", "joint": 3}
    assert second["time"].endswith("Z")
    assert capsys.readouterr().err == "arm: robots.arm: slipped by 2.5 mm\n"


def test_what_json_has_not_is_told_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    log_nodes("5163af85", "arm", {"arm": lambda: (1, 0)})
    itself: dict[str, Any] = {}
    itself["again"] = itself
    logging.getLogger("robots").info("seen", extra={"cells": {(1, 2): 3}})
    logging.getLogger("robots").info("seen", extra={"tree": itself, "joint": 3})
    cells, tree = entries("5163af85", "arm")
    assert (cells["message"], cells["cells"]) == ("seen", "{(1, 2): 3}")
    assert (tree["tree"], tree["joint"]) == ("{'again': {...}}", "3")
    assert capsys.readouterr().err == ""


def test_formatters_of_ones_own_know_the_fields(capsys: pytest.CaptureFixture[str]) -> None:
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(run)s/%(node)s@%(epoch)d %(message)s"))
    logging.getLogger().addHandler(handler)
    log_nodes("aa", "arm", {"arm": lambda: (7, 0)})
    logging.getLogger("x").warning("hot")
    assert capsys.readouterr().err == "aa/arm@7 hot\n"


def test_tracebacks_are_in_the_file_and_what_is_quiet_is_only_there(capsys: pytest.CaptureFixture[str]) -> None:
    log_console()
    log_nodes("aa", "arm", {"arm": lambda: (1, 0)})
    try:
        raise ValueError("no camera")
    except ValueError:
        logging.getLogger("hierax").error("arm: observe failed", exc_info=True, extra=QUIET)
    (entry,) = entries("aa", "arm")
    assert "ValueError: no camera" in entry["exception"]
    assert "quiet" not in entry
    assert capsys.readouterr().err == ""


def test_the_console_shows_what_is_asked_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIERAX_LOG", "debug")
    log_console()
    log_nodes("aa", "arm", {"arm": lambda: (1, 0)})
    logging.getLogger("x").debug("details")
    assert capsys.readouterr().err == "arm: x: details\n"
    assert entries("aa", "arm")[0]["level"] == "DEBUG"


def test_an_unknown_level_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIERAX_LOG", "loud")
    log_console()
    logging.getLogger("x").info("not shown")
    err = capsys.readouterr().err
    assert err == "hierax: HIERAX_LOG: expected DEBUG, INFO, WARNING, ERROR or CRITICAL, got 'LOUD'\n"


def test_a_record_that_does_not_fit_its_arguments_is_kept() -> None:
    record = logging.makeLogRecord({"msg": "%d %d", "args": (1,)})
    assert json.loads(JsonLine().format(record))["message"] == "%d %d (1,)"


def test_files_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "MAX_BYTES", 2000)
    handler = open_log(tmp_path, "arm")
    assert handler is not None
    for number in range(200):
        handler.handle(logging.makeLogRecord({"msg": f"line {number}"}))
    handler.close()
    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert sizes.keys() == {"arm.jsonl", "arm.jsonl.1"}
    assert max(sizes.values()) <= 2000


def test_where_nothing_can_be_written_a_node_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "hierax").write_text("no folder")
    log_console()
    log_nodes("aa", "arm", {"arm": lambda: (1, 0)})
    logging.getLogger("x").warning("all the same")
    err = capsys.readouterr().err
    assert err.count("\n") == 2
    assert "arm.jsonl: the log cannot be written: Not a directory" in err


def test_where_one_may_not_enter_a_launch_and_its_nodes_go_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", f"/{'x' * 300}")  # raises as such a folder does, for root, too
    told: list[str] = []
    begin_log("aa", "toys", Path("toys.yaml"), told.append, lambda: 0).close("the run is over")
    assert [line.rpartition(": ")[2] for line in told] == ["File name too long"]
    assert log_of_run("aa", "audit", lambda: 0).handler is None
    log_console()
    log_nodes("aa", "arm", {"arm": lambda: (1, 0)})
    assert "arm.jsonl: the log cannot be written: File name too long" in capsys.readouterr().err


def test_a_launch_has_a_folder_and_a_log(tmp_path: Path) -> None:
    told: list[str] = []
    log = begin_log("aa", "toys", tmp_path / "toys.yaml", told.append, lambda: 9)
    log.write("arm: its process ended by signal SIGKILL; it is started again")
    log.close("the run is over")
    assert [entry["message"] for entry in entries("aa", "_launch")] == [
        f"toys is launched from {tmp_path}/toys.yaml",
        "arm: its process ended by signal SIGKILL; it is started again",
        "the run is over",
    ]
    assert entries("aa", "_launch")[1]["epoch"] == 9
    assert json.loads((run_folder("aa") / ABOUT).read_text())["hierarchy"] == "toys"
    assert told == []


def test_a_launch_whose_folder_cannot_be_made_says_so_once(tmp_path: Path) -> None:
    (tmp_path / "hierax").write_text("no folder")
    told: list[str] = []
    log = begin_log("aa", "toys", tmp_path, told.append, lambda: 0)
    log.close("the run is over")
    (line,) = told
    assert line.endswith("there will be no logs: Not a directory")
