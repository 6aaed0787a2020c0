"""Runs from Python: epoch by epoch, changed while they go, the same in one process, launched and replayed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from support.script_nodes import Failing, Idle, Interrupted, Meaning, Refusing, seen
from support.toy_nodes import Counter, Summer, Waiting

import hierax
from hierax.nodes.servo import MotionNode, position
from hierax.runtime.commands.main import main
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.node import Node
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import Scheduled, attach_of
from hierax.runtime.execution.single import run as run_at_once
from hierax.runtime.launch.run_file import known_runs
from hierax.runtime.recording.reading import Recording
from hierax.runtime.scripting import runs
from hierax.schemas.limits import LARGEST
from hierax.schemas.roster import Detach

Start = Callable[..., hierax.Run]
MODES = pytest.mark.parametrize("start", [hierax.run, hierax.launch])


def toys(of: Callable[..., Node] = Summer, **fields: object) -> hierax.Hierarchy:
    hierarchy = hierax.Hierarchy("toys", modules=["support.*"], **fields)
    return hierarchy.add("world", Counter).add("sum", of).join("world", "sum", sense=seen)


@MODES
def test_a_run_gives_its_epochs_and_its_report(start: Start) -> None:
    with start(toys(), epochs=20, seed=3) as run:
        epochs = list(run)
        report = run.report()
    assert [epoch.number for epoch in epochs] == list(range(1, 21))
    assert (report.epochs, report.digest) == (20, epochs[-1].digest)
    assert run.belief("sum") == report.nodes["sum"].belief == sum(range(20)), "also when it is over"
    assert report.digest == hierax.run(toys(), epochs=20, seed=3).report().digest


def test_a_run_in_this_process_waits_for_who_goes_through_it() -> None:
    with hierax.run(toys()) as run:
        for epoch in islice(run, 50):
            assert run.belief("world") in (epoch.number, epoch.number + 1), "the next one may be under way"
        with pytest.raises(HieraxError, match=r"there is no node 'sun'; did you mean 'sum'"):
            run.belief("sun")
        assert next(run).number == 51
    assert list(run) == [], "it is ended"


@MODES
def test_nodes_come_and_go_while_it_runs(start: Start) -> None:
    part = hierax.Hierarchy("more").add("more", partial(Summer, scale=2.0)).join("sum", "more", sense=seen)
    with start(toys()) as run:
        next(run)
        first = run.attach(part)
        assert next(epoch for epoch in run if epoch.number > first)
        second = run.replace("more", hierax.Hierarchy("other").add("more", Waiting))
        assert isinstance(run.belief("more"), float)
        third = run.detach("more")
        assert 1 < first < second <= third
        assert next(epoch for epoch in run if epoch.number >= third)
        with pytest.raises(HieraxError, match="more"):
            run.belief("more")
        with pytest.raises(HieraxError, match=r"cannot detach 'more': there is no such node"):
            run.detach("more")
        alien = hierax.Hierarchy("alien").add("alien", MotionNode).join("sum", "alien", sense=position)
        with pytest.raises(HieraxError, match=r"'hierax\.nodes\.servo:MotionNode' may not be loaded in this run"):
            run.attach(alien)
        next(run)


def test_a_change_takes_effect_with_the_first_epoch_that_can_know_of_it() -> None:
    part = hierax.Hierarchy("more").add("more", Summer).join("sum", "more", sense=seen)
    with hierax.run(toys(), epochs=20) as run:
        assert run.attach(part) == 1, "nothing has begun"
        assert next(run).number == 1
        assert run.detach("more") == 3
        digest = run.report().digest
    file = toys().deployment()
    schedule = (Scheduled(1, attach_of(part.snippet(file))), Scheduled(3, Detach("more")))
    assert run_at_once(file, epochs=20, seed=0, schedule=schedule).digest == digest


@MODES
def test_what_a_node_raises_is_raised_where_epochs_are_waited_for(start: Start) -> None:
    with start(toys(Failing)) as run, pytest.raises(HieraxError, match="out of luck"):
        list(run)


def test_a_run_that_has_failed_says_so_whenever_it_is_asked(tmp_path: Path) -> None:
    run = hierax.run(toys(Failing), epochs=10, output=tmp_path / "out")
    with pytest.raises(HieraxError, match="out of luck"):
        list(run)
    for _ in range(2):
        with pytest.raises(HieraxError, match="out of luck"):
            next(run)
        with pytest.raises(HieraxError, match="out of luck"):
            run.report()
    assert not (tmp_path / "out" / "summary.json").exists()


def test_a_run_in_this_process_that_was_broken_off_is_over() -> None:
    with hierax.run(toys(Interrupted), epochs=10) as run:
        with pytest.raises(KeyboardInterrupt):
            list(run)
        with pytest.raises(HieraxError, match=r"the run was broken off \(KeyboardInterrupt\)"):
            run.report()


@pytest.mark.parametrize("what", ["made", "begun", "taken over"])
@MODES
def test_a_change_that_cannot_be_made_is_refused_and_the_run_goes_on(start: Start, what: str) -> None:
    part = hierax.Hierarchy("part").add("sum" if what == "taken over" else "more", partial(Refusing, what=what))
    with start(toys(), epochs=None) as run:
        next(run)
        with pytest.raises(HieraxError, match=f"cannot be {what}"):
            run.replace("sum", part) if what == "taken over" else run.attach(part.join("sum", "more", sense=seen))
        next(run)
        run.detach("sum")


def test_a_world_alone_goes_on_only_while_it_is_iterated_over() -> None:
    with hierax.run(hierax.Hierarchy("alone", modules=["support.*"]).add("world", Idle)) as run:
        assert [(epoch.number, run.belief("world")) for epoch in islice(run, 3)] == [(1, 1), (2, 2), (3, 3)]


def test_of_a_launch_that_nobody_iterates_over_the_last_epochs_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "_MOST_TOLD", 5)
    run = hierax.launch(toys(), epochs=200)
    run._thread.join()  # type: ignore[attr-defined]
    assert len(list(run)) <= 6
    assert run.report().epochs == 200


def test_it_makes_no_difference_whether_a_node_goes_on_with_what_it_returned(tmp_path: Path) -> None:
    """A process that comes in its place has numbers of Python's, and tuples, as a recording has."""
    file = tmp_path / "means.mcap"
    with hierax.run(toys(Meaning), epochs=8, record=file) as run:
        next(run)
        belief = run.belief("sum")
        run.report()
    assert belief["image"].dtype == np.float32
    assert [type(belief["gain"]), belief["seen"]] == [float, ("tuple",)]
    assert main(["replay", str(file), "--verify", "--from", "4"]) == 0


@pytest.mark.parametrize("seed", range(12))
def test_with_rates_a_change_by_hand_is_the_one_that_is_scheduled(seed: int) -> None:
    """A world that waits for nobody is ahead of the others: the last epoch before the change is drained."""
    hierarchy = hierax.Hierarchy("late", epochs=40, modules=["support.*"]).add("world", Counter)
    hierarchy.add("sum", Summer).add("top", Summer, every=3)
    hierarchy.join("world", "sum", sense=seen, context=seen, delay=4).join(
        "sum", "top", sense=seen, context=seen, delay=4
    )
    with hierax.run(hierarchy, seed=seed) as run:
        for epoch in run:
            if epoch.number == 10 + seed:
                break
        first = run.detach("top")
        digest = run.report().digest
    schedule = (Scheduled(first, Detach("top")),)
    assert run_at_once(hierarchy.deployment(), epochs=40, seed=seed, schedule=schedule).digest == digest


@MODES
def test_what_is_attached_fails_alone_and_it_is_said(start: Start, caplog: pytest.LogCaptureFixture) -> None:
    part = hierax.Hierarchy("more").add("more", Failing).join("sum", "more", sense=seen)
    with start(toys()) as run, caplog.at_level("WARNING", "hierax"):
        run.attach(part)
        for _ in run:
            if "out of luck" in caplog.text and "more is detached (on_loss)" in caplog.text:
                break
        next(run)


@MODES
def test_a_change_after_the_end_is_refused(start: Start) -> None:
    with start(toys(), epochs=3) as run:
        list(run)
        with pytest.raises(HieraxError, match="the run"):
            run.detach("sum")


def test_a_launch_that_is_ended_before_it_has_begun_says_so() -> None:
    run = hierax.launch(toys())
    run.close()
    assert list(run) == []
    for ask in (run.report, lambda: run.belief("sum"), lambda: run.detach("sum")):
        with pytest.raises(HieraxError, match="the run was ended before it had begun"):
            ask()


@pytest.mark.parametrize(
    ("hierarchy", "why"),
    [
        (toys(zenoh={"nonsense": 1}), "nonsense"),
        (toys(partial(Refusing, what="made")), "cannot be made"),
    ],
)
def test_a_launch_that_cannot_begin_says_why_whatever_it_is_asked(hierarchy: hierax.Hierarchy, why: str) -> None:
    with hierax.launch(hierarchy) as run:
        for ask in (lambda: run.belief("sum"), lambda: run.detach("sum"), run.report):
            with pytest.raises(HieraxError, match=why):
                ask()


def test_tools_find_the_zenoh_settings_that_a_hierarchy_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bus.json5").write_text("{}", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with hierax.run(toys(zenoh="bus.json5")) as run:
        assert read_deployment(run.deployment.path).zenoh == str(tmp_path / "bus.json5")


def test_leaving_the_block_ends_a_launch() -> None:
    def leave() -> None:
        with hierax.launch(toys()) as run:
            assert next(run).number >= 1
            assert any(each.hierarchy == "toys" for each in known_runs())
            raise KeyError

    with pytest.raises(KeyError):
        leave()
    assert not any(each.hierarchy == "toys" for each in known_runs())


@MODES
def test_recordings_verify(start: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, output = tmp_path / "toys.mcap", tmp_path / "out"
    report = start(toys(), epochs=12, record=file, output=output).report()
    assert main(["replay", str(file), "--verify", "--trust"]) == 0
    assert "12 epochs, 12 digests: all results are alike" in capsys.readouterr().out
    assert json.loads((output / "summary.json").read_text("utf-8"))["digest"] == report.digest
    with pytest.raises(HieraxError, match="is there already"):
        start(toys(), epochs=12, record=file)
    with pytest.raises(HieraxError, match="there is a run in it already"):
        start(toys(), epochs=12, output=output)


@MODES
def test_what_is_no_part_and_no_number_is_refused(start: Start) -> None:
    for name, value in [("epochs", 0), ("seed", -1), ("seed", 1 << 63), ("epochs", 1 << 63)]:
        with pytest.raises(HieraxError, match=f"{name}: expected a whole number from . to {LARGEST}, got {value}"):
            start(toys(), **{name: value})
    with start(toys()) as run, pytest.raises(HieraxError, match=r"expected a hierax\.Hierarchy .* got 'more\.yaml'"):
        run.attach("more.yaml")  # type: ignore[arg-type]


def test_shipped_deployments_run_by_their_names() -> None:
    report = hierax.run("letters", settings=["letters=C?T"]).report()
    assert report.nodes["word"].metrics["CAT"] == pytest.approx(1.0)
    for wrong in ("letters=C?T", {"letters": "C?T"}, [("letters", "C?T")]):
        with pytest.raises(HieraxError, match=r"^settings: expected a list of texts PATH=VALUE, got "):
            hierax.run("letters", settings=wrong)  # type: ignore[arg-type]
    with pytest.raises(HieraxError, match="settings are for deployment files"):
        hierax.run(toys(), settings=["a=1"])


SCRIPT = """
import hierax
from hierax.runtime import Node, World

class Ticks(World):
    def initial_belief(self): return 0
    def predict(self, context, actions, belief): return belief + 1

class Last(Node):
    def initial_belief(self): return None
    def observe(self, observations, belief): return observations[0]

def seen(belief): return (belief,)

def house():
    return hierax.Hierarchy("house").add("world", Ticks).add("last", Last).join("world", "last", sense=seen)

if __name__ == "__main__":
    one = hierax.run(house(), epochs=5).report()
    two = hierax.launch(house(), epochs=5).report()
    assert one.digest == two.digest, (one, two)
    print(two.nodes["last"].belief)
"""


def script(folder: Path, *arguments: str, text: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, input=text, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def test_a_script_launches_classes_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "house_script.py").write_text(SCRIPT, encoding="utf-8")
    done = script(tmp_path, "made/house_script.py")
    assert (done.returncode, done.stdout) == (0, "4\n"), done.stderr


def test_a_command_named_like_a_module_runs_what_modules_have(tmp_path: Path) -> None:
    """As those are that packages bring, pytest's own among them."""
    text = "import hierax, house_nodes\nprint(hierax.run(house_nodes.house(), epochs=5).report().nodes['last'].belief)"
    (tmp_path / "house_nodes.py").write_text(SCRIPT, encoding="utf-8")
    (tmp_path / "numpy").write_text(text, encoding="utf-8")
    done = script(tmp_path, "numpy")
    assert (done.returncode, done.stdout) == (0, "4\n"), done.stderr


UNGUARDED = SCRIPT.partition("if __name__")[0] + "hierax.launch(house(), epochs=5).report()"
LEFT = (
    SCRIPT.partition("if __name__")[0]
    + """
if __name__ == "__main__":
    run = hierax.launch(house())
    print(next(run).number > 0)
"""
)


def test_a_script_that_would_launch_itself_in_each_process_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "house_script.py").write_text(UNGUARDED, encoding="utf-8")
    done = script(tmp_path, "house_script.py")
    assert done.returncode == 1
    assert "house_script launches 'house' while it is imported; guard what it does" in done.stderr.splitlines()[-1]
    assert "supervisor.py" not in done.stderr, "how it got here is not shown"


def test_a_launch_that_a_script_leaves_ends_with_it(tmp_path: Path) -> None:
    (tmp_path / "house_script.py").write_text(LEFT, encoding="utf-8")
    done = script(tmp_path, "house_script.py")
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


RECORDS = """\
import hierax

run = hierax.run("letters", epochs=5, record="a.mcap")
for epoch in run:
    pass
"""


def test_a_run_that_a_script_leaves_is_recorded_as_a_whole(tmp_path: Path) -> None:
    (tmp_path / "house_script.py").write_text(RECORDS, encoding="utf-8")
    done = script(tmp_path, "house_script.py")
    assert (done.returncode, done.stderr) == (0, "")
    assert Recording.open(tmp_path / "a.mcap").ending.last == 5


@pytest.mark.parametrize("part", [toys(staleness=3), toys().probe("sum", Counter)])
def test_what_is_more_than_nodes_and_edges_joins_no_run(part: hierax.Hierarchy) -> None:
    with hierax.run(toys(), epochs=3) as run, pytest.raises(HieraxError, match="joins a run has nodes and edges alone"):
        run.attach(part)


def test_classes_that_no_process_can_import_are_refused(tmp_path: Path) -> None:
    done = script(tmp_path, "-", text=SCRIPT)
    assert done.returncode == 1
    assert ": Last is defined where no other process can import it" in done.stderr


def test_async_operators_run_beside_a_loop() -> None:
    """As in a notebook, whose cells are run by a loop in the same thread."""
    import asyncio

    async def cell() -> float:
        return float(hierax.run(toys(Waiting), epochs=5).report().nodes["sum"].belief)  # type: ignore[arg-type]

    assert asyncio.run(cell()) == sum(range(5))
