"""Nodes come and go while a hierarchy runs: the run stays the one that `hierax run --at` repeats."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from support.launched import processes_of
from support.live import DEPLOYMENT, MIXING, Live, Program, until

BULKY = "support.live_nodes:Bulky"


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path, pace_s=0.01)
    yield launch
    launch.close()


def test_attach_replace_and_detach_are_repeated_to_the_bit(live: Live) -> None:
    top, other, again = live.snippet("top", "high"), live.snippet("high", generation=1), live.snippet("top", "low", 2)
    schedule = [
        f"{live.change('attach', top)}:attach:{top}",
        f"{live.change('replace', 'high', other)}:replace:high:{other}",
        f"{live.change('detach', 'high', '--cascade')}:detach:high:cascade",
        f"{live.change('attach', 'high')}:attach:high",
        f"{live.change('attach', again)}:attach:{again}",
        f"{live.change('detach', 'top')}:detach:top",
    ]
    live.is_repeated_by(*schedule)
    said = "".join(live.launch.err)
    assert "high: its process exits: high: another process runs it from epoch " in said
    assert "top: its process exits: top: it is detached from epoch " in said


def test_what_comes_too_early_for_a_replacement_is_a_line_in_its_log_and_none_on_the_console(live: Live) -> None:
    run, other = live.run["run"], live.snippet("high", generation=1)
    for _ in range(3):
        live.change("replace", "high", other)
        live.goes_on()
    told = live.hierax("logs", "--run", run, "--node", "high", "--format", "json").stdout.splitlines()
    assert any("newcomer" in line for line in told), told
    assert len([line for line in told if "refused" in line]) <= 3
    live.ends()
    assert not [line for line in live.launch.err if "refused" in line]


def test_what_goes_leaves_no_checkpoint_behind_and_what_stays_comes_back_from_its_own(tmp_path: Path) -> None:
    def kept() -> list[str]:
        return sorted(path.name.partition("@")[0] for path in state.iterdir() if path.suffix in (".0", ".1"))

    state = tmp_path / "state"
    live = Live(tmp_path, "--state", str(state), pace_s=0.01)
    try:
        top, other = live.snippet("top", "high"), live.snippet("high", generation=1)
        schedule = []
        for _ in range(2):
            for change in (("replace", "high", other), ("attach", top), ("detach", "top")):
                schedule.append(":".join([str(live.change(*change)), *change]))
                live.goes_on()
        each = sorted(f"{name}.{slot}" for name in ("world", "low") for slot in "01")
        until(lambda: kept() == ["high", "high", *each], "no other checkpoints than those of the nodes that are there")
        os.kill(live.run["nodes"]["high"]["pid"], signal.SIGKILL)
        live.goes_on()
        live.is_repeated_by(*schedule)
    finally:
        live.close()


def test_a_world_by_itself_is_joined_and_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = DEPLOYMENT[: DEPLOYMENT.index("  low: ")]
    monkeypatch.setattr("support.live.DEPLOYMENT", alone)
    live = Live(tmp_path, pace_s=0.01)
    try:
        top = live.snippet("top", "world")
        schedule = [f"{live.change('attach', top)}:attach:{top}"]
        live.goes_on()
        schedule.append(f"{live.change('detach', 'top')}:detach:top")
        live.goes_on()
        live.is_repeated_by(*schedule)
    finally:
        live.close()


def test_low_latency_links_hand_over_short_beliefs_and_say_what_is_too_long(tmp_path: Path) -> None:
    live = Live(tmp_path, "--set", "low_latency=true", pace_s=0.01)
    try:
        top, other = live.snippet("top", "high"), live.snippet("top", generation=1)
        schedule = [
            f"{live.change('attach', top)}:attach:{top}",
            f"{live.change('replace', 'top', other)}:replace:top:{other}",
        ]
        big, too = live.snippet("big", "high"), live.snippet("big", generation=1)
        for path in (big, too):
            text = Path(path).read_text(encoding="utf-8").replace("hierax.runtime.sim.nodes:Mixer", BULKY)
            Path(path).write_text(text, encoding="utf-8")
        schedule.append(f"{live.change('attach', big)}:attach:{big}")
        done = live.hierax("replace", "big", too)
        assert done.returncode == 1
        assert re.match(r"error: no answer from big(, high)? within 5 s\n", done.stderr), (done.stderr, live.launch.err)
        said = "".join(live.launch.err)
        assert re.search(r"not sent: State of 1\d+ bytes on \S+/words/big; low-latency links carry at most 32768", said)
        live.goes_on()
        live.is_repeated_by(*schedule)
    finally:
        live.close()


def test_changes_that_are_asked_for_at_once_are_made_one_after_the_other(live: Live) -> None:
    sides = [live.snippet(f"side{number}", "low") for number in range(4)]
    with ThreadPoolExecutor() as pool:
        epochs = list(pool.map(lambda path: live.change("attach", path), sides))
    assert len(set(epochs)) == len(sides)
    ordered = sorted(zip(epochs, sides, strict=True))
    live.is_repeated_by(*(f"{epoch}:attach:{path}" for epoch, path in ordered))


def test_a_refused_change_leaves_the_run_as_it_is(live: Live) -> None:
    node = 'nodes:\n  bad: {class: "support.slow_nodes:Failing", parameters: {epok: 3}}\n'
    edges = 'edges:\n  low -> bad: {sense: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: x}}}\n'
    path = live.folder / "bad.yaml"
    path.write_text(node + edges, encoding="utf-8")
    done = live.hierax("attach", str(path))
    assert done.returncode == 1
    assert "did you mean 'epoch'?" in done.stderr
    path.write_text('nodes:\n  high: {class: "support.slow_nodes:Stuck", parameters: {epoch: 0}}\n', encoding="utf-8")
    done = live.hierax("replace", "high", str(path))
    assert done.returncode == 1
    assert "error: high: cannot take over the belief: belief: expected NoneType" in done.stderr
    assert live.run["nodes"].keys() == {"world", "low", "high"}
    live.goes_on()
    live.is_repeated_by()


FAILING = """\
nodes:
  top: {{class: "support.failing_nodes:Failing", parameters: {{name: top, operator: {operator}}}}}
edges:
  {lower} -> top: {{{functions}}}
"""

FAILURES = {
    "top: observe": ("low", "observe", "Mix"),
    "world->top: sense": ("world", "none", "FailingMix"),
    "low->top: sense": ("low", "none", "SetMix"),
}
"""What fails: the lower node, the operator, the sense function."""


def failing(live: Live, number: int, lower: str, operator: str, sense: str, epoch: int = 1) -> str:
    """The path of a snippet whose node fails."""
    operator += f", epoch: {epoch}"
    module = MIXING if sense == "Mix" else "support.failing_nodes"
    path = live.folder / f"failing-{number}.yaml"
    function = f'sense: {{function: "{module}:{sense}", parameters: {{name: x}}}}'
    path.write_text(FAILING.format(operator=operator, lower=lower, functions=function), encoding="utf-8")
    return str(path)


def test_what_fails_in_its_first_epoch_is_refused_and_what_it_was_to_replace_goes_on(live: Live) -> None:
    for number, (place, what) in enumerate(FAILURES.items()):
        done = live.hierax("attach", failing(live, number, *what))
        assert (done.returncode, len(done.stderr.splitlines())) == (1, 1), done.stderr
        assert re.match(rf"error: {place} in epoch \d+: ", done.stderr), done.stderr
        assert ("a set cannot be sent" if "SetMix" in what else "RuntimeError: out of luck (") in done.stderr
    assert live.run["nodes"].keys() == {"world", "low", "high"}
    before = live.run["nodes"]["high"]
    instead = live.folder / "instead.yaml"
    node = 'nodes:\n  high: {class: "support.failing_nodes:Failing", parameters: {name: high, operator: observe}%s}\n'
    for policy in ("", ", on_loss: detach"):
        instead.write_text(node % policy, encoding="utf-8")
        done = live.hierax("replace", "high", str(instead))
        assert (done.returncode, len(done.stderr.splitlines())) == (1, 1), done.stderr
        assert re.match(r"error: high: observe in epoch \d+: RuntimeError: out of luck \(", done.stderr), done.stderr
        assert done.stderr.endswith("; what it was to replace goes on\n")
    live.goes_on()
    assert live.run["nodes"]["high"] == before, "the same process, not started again"
    live.is_repeated_by()


def test_what_was_replaced_and_dies_before_what_replaces_it_fails_goes_on_from_its_checkpoint(live: Live) -> None:
    pid = live.run["nodes"]["high"]["pid"]
    instead = live.folder / "instead.yaml"
    node = 'nodes:\n  high: {class: "support.failing_nodes:Killing", parameters: {name: high, pid: %d}}\n'
    instead.write_text(node % pid, encoding="utf-8")
    done = live.hierax("replace", "high", str(instead))
    assert re.match(r"error: high: observe in epoch \d+: RuntimeError: out of luck \(", done.stderr), done.stderr
    assert done.stderr.endswith("; what it was to replace goes on\n")
    live.launch.says("high: its process ended by signal SIGKILL; it is started again")
    live.goes_on()
    assert live.run["nodes"]["high"]["pid"] not in (0, pid)
    live.is_repeated_by()


def test_what_fails_later_is_detached_there(live: Live) -> None:
    path = failing(live, 0, "low", "count", "Mix", epoch=40)
    epoch = live.change("attach", path)
    said = live.launch.says("top is detached (on_loss)")
    assert said.startswith(f"hierax: top: observe in epoch {epoch + 40}: RuntimeError: out of luck (")
    live.launch.says(f"top: its process exits: top: it is detached from epoch {epoch + 40} on")
    live.goes_on()
    live.is_repeated_by(f"{epoch}:attach:{path}")


# --- a process that comes back when it is no longer wanted; a stopped one is cut off, as far as the others can see


class Kept:
    """A node whose process another keeper has started."""

    def __init__(self, live: Live, policy: str = "") -> None:
        self.path = live.snippet("top", "high", policy=policy)
        self.keeper: Program = live.start("attach", self.path, "--here")
        self.epoch = int(self.keeper.says("attached top at epoch").split()[-1])
        self.schedule = f"{self.epoch}:attach:{self.path}"
        self.pid = until(lambda: processes_of(self.keeper.process.pid))[0]
        self.stopped = False

    def stop(self) -> None:
        """Have it say nothing any more."""
        os.kill(self.pid, signal.SIGSTOP)
        self.stopped = True

    def go_on(self) -> None:
        """Have it go on."""
        os.kill(self.pid, signal.SIGCONT)
        self.stopped = False


@pytest.fixture
def kept(live: Live) -> Iterator[Callable[..., Kept]]:
    made: list[Kept] = []

    def make(policy: str = ", on_loss: restart") -> Kept:
        made.append(Kept(live, policy))
        return made[-1]

    yield make
    for each in made:
        if each.stopped:
            each.go_on()


def test_a_process_whose_place_is_taken_is_refused_and_exits(live: Live, kept: Callable[..., Kept]) -> None:
    old = kept()
    old.stop()
    live.launch.says("top: its process is lost")
    detached = live.change("detach", "top")
    anew = live.snippet("top", "low", 1)
    attached = live.change("attach", anew)
    live.goes_on()
    old.go_on()
    assert old.keeper.ends() == 0
    assert "top: its process exits: top: another process runs it\n" in "".join(old.keeper.err)
    live.goes_on()
    assert live.run["nodes"]["top"]["state"] == "running"
    live.is_repeated_by(old.schedule, f"{detached}:detach:top", f"{attached}:attach:{anew}")


def test_a_process_whose_node_is_gone_is_refused_and_exits(live: Live, kept: Callable[..., Kept]) -> None:
    old = kept(", on_loss: detach")
    old.stop()
    live.launch.says("top: it did not come back in time (rejoin_timeout); it is detached (on_loss)")
    until(lambda: "top" not in live.run["nodes"])
    old.go_on()
    assert old.keeper.ends() == 0
    assert "top: its process exits: top: it is no part of the hierarchy\n" in "".join(old.keeper.err)
    report = live.ends()
    lost = int(live.launch.says("top: its process is lost in epoch").split()[-1])
    assert report["digest"] == live.repeated(report["epochs"], old.schedule, f"{lost}:detach:top")["digest"]


def test_a_process_that_is_waited_for_is_replaced_by_the_next_one(live: Live, kept: Callable[..., Kept]) -> None:
    old = kept()
    old.stop()
    live.launch.says("top: its process is lost")
    before = live.epoch
    old.go_on()
    old.keeper.says("it is started again")
    until(lambda: live.epoch > before + 10)
    assert live.run["nodes"]["top"]["state"] == "elsewhere"
    live.is_repeated_by(old.schedule)
    assert old.keeper.ends() == 0
    assert "top: its process exits: top: the run is over\n" in "".join(old.keeper.err)


def test_a_keeper_ends_its_processes_when_the_launch_is_gone(live: Live, kept: Callable[..., Kept]) -> None:
    old = kept()
    live.launch.process.kill()
    assert old.keeper.ends() == 1
    assert old.keeper.err[-1].startswith("error: the launch at tcp/127.0.0.1:")
    assert not Path(f"/proc/{old.pid}").exists()
