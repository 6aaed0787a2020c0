"""What launches leave in folders, and what they go on without."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.launched import HIERAX, Command, Launched, environment, until
from support.pace import paced

WORD = "hunter2word"
SET = f"zenoh.transport.auth.usrpwd.password={WORD}"
USER = "zenoh.transport.auth.usrpwd.user=me"
TIMEOUT_S = 120.0


def hierax(folder: Path, *arguments: str, prefix: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    command = [*prefix, *HIERAX, *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, env=environment(folder), check=False
    )


def modes(folder: Path) -> Iterator[int]:
    for path in folder.rglob("*"):
        yield path.stat().st_mode & 0o077


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run that is over, whose Zenoh has had a password."""
    folder = tmp_path_factory.mktemp("finished")
    users = tmp_path_factory.mktemp("zenoh") / "users"
    users.write_text(f"me:{WORD}\n")
    words = f"zenoh.transport.auth.usrpwd.dictionary_file={users}"
    options = (
        "--set",
        USER,
        "--set",
        words,
        "--set",
        SET,
        "--state",
        "state",
        "--output",
        "out",
        "--record",
        "run.mcap",
    )
    done = hierax(folder, "launch", "letters", "--epochs", "4", *options)
    assert done.returncode == 0, done.stderr
    return folder


def test_a_password_is_nowhere(finished: Path) -> None:
    logs = Path(os.environ["XDG_STATE_HOME"])
    for path in [*finished.rglob("*"), *logs.rglob("*")]:
        assert not path.is_file() or WORD.encode() not in path.read_bytes(), path
    settings = json.loads((finished / "state" / "run.json").read_text())["settings"]
    assert (settings[0], settings[2:]) == (USER, [SET.partition("=")[0]])


def test_the_state_is_for_its_user_alone(finished: Path) -> None:
    assert set(modes(finished / "state")) == {0}
    assert (finished / "state").stat().st_mode & 0o777 == 0o700


def test_a_run_that_is_over_is_not_resumed(finished: Path) -> None:
    lacking = hierax(finished, "launch", "--resume", "state")
    path = SET.partition("=")[0]
    what = f"what --set {path} gave is secret and was not stored; give it again: --set {path}=VALUE"
    assert (lacking.returncode, lacking.stderr) == (1, f"error: {what}\n")
    done = hierax(finished, "launch", "--resume", "state", "--set", SET)
    what = "there is nothing to resume: the run is over, it has done 4 epochs; a greater number of --epochs goes on"
    assert (done.returncode, done.stderr) == (1, f"error: {finished}/state: {what}\n")


def test_a_run_goes_on_behind_its_end(finished: Path, tmp_path: Path) -> None:
    for name in ("state", "out"):
        shutil.copytree(finished / name, tmp_path / name)
    fields = json.loads((finished / "state" / "run.json").read_text())
    (tmp_path / "state" / "run.json").write_text(json.dumps({**fields, "output": str(tmp_path / "out")}))
    done = hierax(tmp_path, "launch", "--resume", "state", "--trust", "--set", SET, "--epochs", "6", "--format", "json")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["epochs"] == 6


def test_a_resumed_run_without_an_output_is_not_mixed_with_the_one_in_a_folder(finished: Path, tmp_path: Path) -> None:
    for name in ("state", "out"):
        shutil.copytree(finished / name, tmp_path / name)
    fields = json.loads((finished / "state" / "run.json").read_text())
    (tmp_path / "state" / "run.json").write_text(json.dumps({**fields, "output": ""}))
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    resumes = ("launch", "--resume", str(tmp_path / "state"), "--trust", "--set", SET, "--epochs", "6")
    done = hierax(tmp_path / "out", *resumes, "--output", ".")
    assert done.returncode == 1, done.stderr
    assert "error: --output .: there is a run in it already" in done.stderr
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()} == before


def test_a_run_that_was_ended_before_its_first_epoch_is_not_resumed(finished: Path, tmp_path: Path) -> None:
    state = tmp_path / "state"
    state.mkdir(mode=0o700)
    shutil.copy(finished / "state" / "run.json", state)
    why = "the run was ended before its first epoch; launch it anew, with --overwrite"
    what = f"error: {state}: there is nothing to resume: {why}\n"
    for _ in range(2):  # with files of a record that was never written, too
        done = hierax(tmp_path, "launch", "--resume", "state", "--set", SET)
        assert (done.returncode, done.stderr) == (1, what)
        for slot in "01":
            (state / f"world.{slot}").write_bytes(b"hieraxC\x01" + bytes(4088))


def test_a_launch_that_is_killed_as_it_comes_up_is_resumed_or_refused(tmp_path: Path) -> None:
    with Launched(tmp_path, "letters", "--epochs", "5") as launch:
        until((tmp_path / "state" / "run.json").exists, "what it takes to resume")
        os.kill(launch.process.pid, signal.SIGKILL)
        launch.end()
    until(lambda: not any(launch.pid(name) for name in ("world", "word", "letter1", "letter2", "letter3")), "its end")
    done = hierax(tmp_path, "launch", "--resume", "state")
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    if done.returncode:
        assert "there is nothing to resume" in done.stderr


def test_where_nothing_can_be_written_nothing_starts(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for option, what in (
        ("--state", f"--state {tmp_path}/file/x: it cannot be written: Not a directory"),
        ("--output", "--output file/x: it cannot be made or written: Not a directory"),
        ("--record", "file/x: cannot be written: Not a directory"),
    ):
        done = hierax(tmp_path, "launch", "letters", option, "file/x")
        assert (done.returncode, done.stderr) == (1, f"error: {what}\n")
        assert not done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_two_launches_do_not_share_an_output_nor_a_recording(tmp_path: Path) -> None:
    with Launched(
        tmp_path, paced(tmp_path, "letters"), "--epochs", "1000000", "--record", str(tmp_path / "run.mcap")
    ) as launch:
        launch.until_epoch(3)
        for options in (["--output", "output"], ["--record", "run.mcap"], ["--output", "output", "--overwrite"]):
            done = hierax(tmp_path, "run", "letters", *options)
            assert done.returncode == 1
            assert f"process {launch.process.pid} is writing" in done.stderr, done.stderr


def test_a_launch_leaves_the_state_of_another_one_alone(tmp_path: Path) -> None:
    """Neither of one that runs, nor of one that was killed, unless it is told to replace that."""
    begin = ("launch", "letters", "--seed", "7", "--epochs", "2", "--format", "json", "--state")
    with Launched(tmp_path, paced(tmp_path, "letters"), "--seed", "3", "--epochs", "1000000") as launch:
        launch.until_epoch(3)
        kept = (launch.state / "run.json").read_bytes()
        for more in ((), ("--overwrite",)):
            done = hierax(tmp_path, *begin, "state", *more)
            holder = f"process {launch.process.pid} is running with its checkpoints there"
            what = f"error: {launch.state}: {holder}; wait for its end, or name another folder\n"
            assert (done.returncode, done.stderr) == (1, what)
        os.kill(launch.process.pid, signal.SIGKILL)
        launch.end()
        until(lambda: not any(map(launch.pid, ("world", "word", "letter1", "letter2", "letter3"))), "its end")
    done = hierax(tmp_path, *begin, "state")
    assert done.returncode == 1
    assert f"error: --state {launch.state}: there is a run in it already (run.json); --resume" in done.stderr
    assert (launch.state / "run.json").read_bytes() == kept
    done, fresh = (hierax(tmp_path, *begin, *state) for state in (("state", "--overwrite"), ("fresh",)))
    assert (done.returncode, fresh.returncode) == (0, 0), done.stderr + fresh.stderr
    assert json.loads(done.stdout)["digest"] == json.loads(fresh.stdout)["digest"]


def is_swept(folder: Path) -> bool:
    """Whether systemd-tmpfiles would go into a folder: it does if it can lock it."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(file)
    return True


def test_temporary_files_of_a_launch_are_not_swept_as_long_as_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    arguments = ("launch", paced(tmp_path, "letters"), "--epochs", "1000000", "--output", str(tmp_path / "out"))
    with Command(tmp_path, *arguments) as launch:
        until((tmp_path / "out" / "digests.msgpack").exists, "it is under way")
        (state,) = tmp_path.glob("hierax-*/")
        assert (state / "world.0").exists()
        assert [is_swept(folder) for folder in (state, tmp_path / "hierax")] == [False, False]
        os.kill(launch.process.pid, signal.SIGKILL)
        launch.end()
        until(lambda: is_swept(state) and is_swept(tmp_path / "hierax"), "they are swept")


def can(*command: str) -> bool:
    return subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0


LITTLE = ("prlimit", "--memlock=65536:65536")
WITHOUT = {
    "little memlock": (*(("setpriv", "--bounding-set", "-ipc_lock") if os.geteuid() == 0 else ()), *LITTLE),
    "no shared memory": ("unshare", "-m", "sh", "-c", 'mount -o remount,bind,ro /dev/shm && exec "$@"', "sh"),
}


def test_who_looks_from_another_container_leaves_a_launch_known(tmp_path: Path) -> None:
    container = ("unshare", "--pid", "--fork", "--mount-proc")
    if not can(*container):
        pytest.skip("this machine does not let processes be numbered anew")
    with Launched(tmp_path, paced(tmp_path, "letters"), "--epochs", "1000000") as launch:
        launch.until_epoch(3)
        looked = [hierax(tmp_path, "ps", "--format", "json", prefix=prefix) for prefix in (container, ())]
        assert [len(json.loads(done.stdout)["runs"]) for done in looked] == [1, 1], looked
        os.kill(launch.process.pid, signal.SIGKILL)
        launch.end()
        gone = hierax(tmp_path, "ps", prefix=container)
        assert gone.stdout == "no launch runs on this machine\n"
        assert list((tmp_path / "hierax").iterdir()) == []


@pytest.mark.parametrize("what", WITHOUT)
def test_a_launch_goes_on_without_shared_memory(tmp_path: Path, what: str) -> None:
    prefix = WITHOUT[what]
    if shutil.which(prefix[0]) is None or not can(*prefix):
        pytest.skip("this machine does not let it be taken away")
    options = ("--epochs", "3", "--format", "json")
    done = hierax(tmp_path, "launch", "tracking", *options, prefix=prefix)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["epochs"] == 3
    (line,) = [line for line in done.stderr.splitlines() if "shared memory" in line]
    assert line.startswith("hierax: no shared memory, large messages are copied: ")
    looked = hierax(tmp_path, "doctor", "--format", "json", prefix=prefix)
    assert "/dev/shm cannot be written" in looked.stdout or "a process may lock 64 KiB" in looked.stdout
