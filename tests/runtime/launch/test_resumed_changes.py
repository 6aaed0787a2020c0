"""Launches that are killed while, or just after, a change takes effect, and are resumed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.launched import processes_of
from support.live import Live, until

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.launch.frames import COME_BACK
from hierax.runtime.launch.orders import LaunchOptions, Orders
from hierax.runtime.launch.run_file import read_run
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.schemas.checkpoint import WorldRecord, encode_world
from hierax.schemas.values import encode_value

WAITING = """\
nodes:
  high: {{class: "support.failing_nodes:Waiting", parameters: {{name: high, until: "{until}"}}}}
"""


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path, "--state", str(tmp_path / "state"))
    yield launch
    launch.close()


def killed(live: Live) -> None:
    """The launch is killed, and all its processes are gone."""
    processes = processes_of(live.launch.process.pid)
    live.launch.process.kill()
    live.launch.ends()
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in processes), "the end of the processes")
    shutil.rmtree(live.folder / "hierax")  # what it was found by


def resume(live: Live) -> None:
    live.launch = live.start("launch", "--resume", str(live.folder / "state"), "--format", "json")


def begun_again(live: Live) -> None:
    """Wait until what was resumed has done some epochs."""
    live._client = None
    until(lambda: list((live.folder / "hierax").glob("*.json")), "the launch")
    until(lambda: live.epoch, "an epoch")
    live.goes_on()


def test_a_change_counts_that_the_launch_did_not_live_to_write_down(live: Live) -> None:
    """The world's record has it, in the same instant in which it takes effect."""
    written = live.folder / "state" / "run.json"
    before = written.read_bytes()
    other, top = live.snippet("high", generation=1), live.snippet("top", "high")
    replaced, attached = live.change("replace", "high", other), live.change("attach", top)
    live.goes_on()
    killed(live)
    written.write_bytes(before)
    resume(live)
    begun_again(live)
    live.is_repeated_by(f"{replaced}:replace:high:{other}", f"{attached}:attach:{top}")


def test_set_leaves_what_follows_when_the_process_ends_as_it_is(live: Live) -> None:
    attached = live.snippet("top", "high", policy=", on_loss: detach, rejoin_timeout: 3")
    live.change("attach", attached)
    live.change("set", "top.generation=1")
    terms = read_run(live.folder / "state").terms["top"]
    assert (terms["on_loss"], terms["rejoin_timeout_s"]) == ("detach", 3)


def replacing(live: Live) -> Path:
    """Have a node replaced by one that waits in its first epoch, and wait until it does; gives for what."""
    go_on = live.folder / "go-on"
    snippet = live.folder / "waiting.yaml"
    snippet.write_text(WAITING.format(until=go_on), encoding="utf-8")
    live.start("replace", "high", str(snippet))
    until(go_on.with_suffix(".waits").exists, "the first epoch of what replaces another one")
    return go_on


def test_a_run_goes_on_that_was_killed_in_the_first_epoch_of_what_replaces_another_node(live: Live) -> None:
    go_on = replacing(live)
    epoch = live.epoch + 1
    killed(live)
    go_on.touch()
    resume(live)
    begun_again(live)
    live.is_repeated_by(f"{epoch}:replace:high:{live.folder / 'waiting.yaml'}")


def test_what_fails_after_that_ends_the_run_as_nothing_is_left_to_go_on(live: Live) -> None:
    go_on = replacing(live)
    killed(live)
    go_on.write_text("out of luck", encoding="utf-8")
    resume(live)
    assert live.launch.ends() == 1
    error = live.launch.err[-1]
    assert error.startswith("error: high: observe in epoch "), live.launch.err
    assert "RuntimeError: out of luck" in error
    assert error.endswith("what high has replaced cannot go on: its process is lost and is not started again\n")


def orders_of(folder: Path, request: str) -> Orders:
    """The orders of a run whose world has recorded that a node came with a request."""
    deployment = read_deployment("letters")
    state = folder / "state"
    state.mkdir(mode=0o700)
    options = LaunchOptions(3, 9, state)
    terms = ProcessTerms(max_restarts=7, on_loss="stop")
    Orders(deployment, "5163af85", "", options).save({"0badcafe": {"letter1": terms}})
    processes = dict.fromkeys(deployment.roster.nodes, ("token", 0, 1, "")) | {"letter1": ("token", 1, 4, request)}
    belief = encode_value((0, "", ()))
    record = WorldRecord(5, 0, 0, encode_value(deployment.roster.plain()), 1, bytes(32), belief)
    storage = MappedFile(state / "world", "process")
    for _ in range(2):
        Slots(storage).write(encode_world(record._replace(processes=encode_value(processes))))
    storage.close()
    return Orders(deployment, "5163af86", "", options, read_run(state))


def test_nodes_go_on_from_where_the_worlds_record_has_them_on_the_terms_they_came_with(tmp_path: Path) -> None:
    orders = orders_of(tmp_path, "0badcafe")
    orders.roster()
    assert Path(orders.order("letter1", "token", COME_BACK).checkpoint).name == "letter1@0badcafe"
    assert Path(orders.order("letter2", "token", COME_BACK).checkpoint).name == "letter2"
    assert (orders.terms("letter1").max_restarts, orders.terms("letter1").on_loss) == (7, "stop")
    orders.save()
    assert json.loads((tmp_path / "state" / "run.json").read_text())["terms"]["letter1"]["max_restarts"] == 7


def test_a_record_leads_to_no_checkpoint_outside_of_the_folder(tmp_path: Path) -> None:
    with pytest.raises(HieraxError, match=r"the world's record: expected the identification of the change"):
        orders_of(tmp_path, f"{os.sep}..{os.sep}precious").roster()
