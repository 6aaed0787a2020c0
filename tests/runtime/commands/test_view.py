from __future__ import annotations

import importlib.util
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from support.launched import Command, processes_of, until
from support.pace import paced

from hierax.runtime.commands.main import main
from hierax.runtime.deployment import Deployment

needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="the extra [view] is not installed")


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["view", *arguments]) == 1
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_without_rerun_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    found = importlib.util.find_spec

    def find_spec(name: str, *more: Any) -> Any:
        return None if name == "rerun" else found(name, *more)

    monkeypatch.setattr(importlib.util, "find_spec", find_spec)
    expected = "error: hierax view needs Rerun, the extra [view]: pip install 'hierax[view]'"
    assert failure(capsys, "servo") == expected


@needs_rerun
@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("servo", "--native", "--save", "x.rrd"), "--native and --save: give one of them"),
        (("servo", "--run", "5163af85"), "give a file, or say which launch is meant: not both"),
        (("srvo",), "did you mean 'servo'?"),
        (("nowhere.mcap",), "nowhere.mcap: cannot be read: No such file or directory"),
        ((), "no launch runs on this machine"),
        (("rec.mcap", "--set", "noise=4"), "--set: only with a deployment"),
        (("rec.mcap", "--seed", "3"), "--seed: only with a deployment"),
        (("--epochs", "3"), "--epochs: only with a deployment"),
        (("servo", "--from", "3"), "--from: only with a recording"),
        (("servo", "--to", "5"), "--to: only with a recording"),
        (("servo", "--port", "9", "--save", "x.rrd"), "--port: not with --save"),
        (("servo", "--memory", "1MB", "--save", "x.rrd"), "--memory: not with --save"),
        (("servo", "--open", "--native"), "--open: not with --native"),
        (("servo", "--set", "view.show=no.where:thing", "--save", "x.rrd"), "--set view.show=no.where:thing: "),
        (("servo", "--set", "view.layout=[[1]]", "--save", "x.rrd"), "view.layout"),
    ],
)
def test_what_cannot_be_done_is_told_in_a_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    what: str,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert what in failure(capsys, *arguments)


@needs_rerun
def test_a_run_and_its_recording_go_into_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mcap", reason="the extra [record] is not installed")
    run, seen, again = tmp_path / "run.mcap", tmp_path / "seen.rrd", tmp_path / "again.rrd"
    assert main(["view", "servo", "--epochs", "5", "--save", str(seen)]) == 0
    assert main(["run", "servo", "--epochs", "5", "--record", str(run)]) == 0
    assert main(["view", str(run), "--from", "2", "--save", str(again)]) == 0
    for path in (seen, again):
        assert b"/position_m/world/object" in path.read_bytes()
    late = (str(run), "--from", "9", "--save", str(again))
    assert f"{again}: is there already; --overwrite replaces it" in failure(capsys, *late)
    assert "there is no committed epoch in it from 9 to its end" in failure(capsys, *late, "--overwrite")
    assert b"/position_m/world/object" in again.read_bytes()  # neither has replaced it
    other = tmp_path / "other.rrd"
    assert main(["view", *late[:-1], str(other)]) == 1
    assert "seen at" not in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == [again, run, seen]
    assert f"{run}: is no file of Rerun's" in failure(capsys, str(run), "--save", str(run), "--overwrite")


@needs_rerun
def test_what_was_drawn_until_ctrl_c_is_kept(tmp_path: Path) -> None:
    saved = tmp_path / "run.rrd"
    with Command(tmp_path, "view", paced(tmp_path, "servo"), "--epochs", "10000000", "--save", str(saved)) as view:
        shown = lambda: [path.stat().st_size for path in tmp_path.glob(".run.rrd.*")]  # noqa: E731
        until(lambda: max(shown(), default=0) > 50_000, "something is shown")
        os.kill(view.process.pid, signal.SIGINT)
        view.end()
        assert view.process.returncode == 130, view.err
        assert view.err.endswith(f"seen at {saved}\ninterrupted"), view.err
    assert b"/position_m/world/object" in saved.read_bytes()
    assert shown() == []


@needs_rerun
@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_probes_hear_whether_they_may_overwrite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: tuple[str, ...]
) -> None:
    seen: list[bool] = []

    def run_seen(deployment: Deployment, *_: object, **options: object) -> None:
        seen.extend(each.overwrite for each in deployment.probes)

    monkeypatch.setattr("hierax.runtime.viewing.live.run_seen", run_seen)
    assert main(["view", paced(tmp_path, "servo"), "--save", str(tmp_path / "x.rrd"), *more]) == 0
    assert seen
    assert set(seen) == {bool(more)}


@needs_rerun
def test_ctrl_c_ends_looking_at_a_launch_that_runs_on(tmp_path: Path) -> None:
    saved = tmp_path / "live.rrd"
    with Command(tmp_path, "launch", paced(tmp_path, "servo"), "--epochs", "10000000") as launch:
        until(lambda: any(tmp_path.rglob("*.json")), "the launch runs")
        with Command(tmp_path, "view", "--save", str(saved)) as view:
            shown = lambda: [path.stat().st_size for path in tmp_path.glob(".live.rrd.*")]  # noqa: E731
            until(lambda: max(shown(), default=0) > 50_000, "something is shown")
            os.kill(view.process.pid, signal.SIGINT)
            view.end()
            assert view.process.returncode == 0, view.err
        with Command(tmp_path, "view") as view:  # and the viewer with it
            view.until_said("seen at http://")
            os.killpg(view.process.pid, signal.SIGINT)  # as a terminal does
            view.end()
            assert view.process.returncode == 0, view.err
            assert "that is all" not in view.err
            assert "Traceback" not in view.err
        assert launch.process.poll() is None, launch.err
        os.kill(launch.process.pid, signal.SIGINT)
        launch.end()
    assert b"/position_m/world/object" in saved.read_bytes()


@needs_rerun
def test_a_viewer_that_ends_is_not_shown_to_any_longer(tmp_path: Path) -> None:
    with Command(tmp_path, "launch", paced(tmp_path, "servo"), "--epochs", "10000000") as launch:
        until(lambda: any(tmp_path.rglob("*.json")), "the launch runs")
        with Command(tmp_path, "view") as view:
            view.until_said("seen at http://")
            until(lambda: processes_of(view.process.pid) != [], "the viewer runs")
            for pid in processes_of(view.process.pid):
                os.kill(pid, signal.SIGKILL)
            view.end()
            assert view.process.returncode == 1, view.err
            assert "error: Rerun's viewer has ended: " in view.err
        assert launch.process.poll() is None, launch.err
