"""Whether a launch goes on, as an exit code."""

import json
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from support.live import Live, until


@contextmanager
def held_up(live: Live) -> Iterator[None]:
    """The world does not come to the end of its next epoch meanwhile."""
    pause = live.folder / "pause"
    pause.touch()
    try:
        yield
    finally:
        pause.unlink()


def unwell(live: Live, *options: str) -> str:
    """What is said once no epoch comes any more."""

    def said() -> str:
        done = live.hierax("health", "--within", "0.3", *options)
        return done.stdout if done.returncode == 1 else ""

    return str(until(said, "the end of epochs"))


def test_a_launch_that_goes_on_is_well(live: Live) -> None:
    done = live.hierax("health", "--format", "json")
    assert done.returncode == 0
    told = json.loads(done.stdout)
    assert told.pop("epoch") > 0
    run = live.run["run"]
    assert told == {"goes_on": True, "hierarchy": "live", "run": run, "missed": {}}
    assert live.hierax("health").stdout.startswith(f"live, run {run}: epoch ")


def test_one_that_commits_no_epoch_in_time_is_not_and_says_so(live: Live) -> None:
    with held_up(live):
        assert unwell(live).endswith(", none after it within 0.3 s\n")
        assert json.loads(unwell(live, "--format", "json"))["goes_on"] is False
        assert live.hierax("health", "--within", "0").returncode == 0
    assert live.hierax("health").returncode == 0


def test_a_node_that_is_missed_is_named_and_held_against_nobody_while_it_is_started_again(live: Live) -> None:
    pid = live.run["nodes"]["high"]["pid"]
    os.kill(pid, signal.SIGKILL)
    named = "; high is restarting"
    until(lambda: named in live.hierax("health", "--within", "0").stdout or live.run["nodes"]["high"]["restarts"])
    assert live.hierax("health", "--within", "60").returncode == 0


def test_a_launch_that_is_stopped_does_not_answer(live: Live) -> None:
    pid = live.launch.process.pid
    os.kill(pid, signal.SIGSTOP)
    try:
        done = live.hierax("health", "--within", "0")
    finally:
        os.kill(pid, signal.SIGCONT)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    live.goes_on()


def test_without_a_launch_there_is_nothing_that_goes_on(live: Live) -> None:
    done = live.hierax("health", "--run", "nobody")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no launch 'nobody' runs on this machine" in done.stderr
