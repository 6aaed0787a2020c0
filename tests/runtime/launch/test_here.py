"""What a launch on another machine orders: no more of it counts here than what was asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.live import hierax as said_by

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.launch.attached_processes import AttachedHere, read_orders
from hierax.runtime.loading.allowance import Allowance, NotAllowedError
from hierax.runtime.transport.hub import Hub
from hierax.schemas.keys import Keys
from hierax.schemas.roster import Reference

MIXING = "hierax.runtime.sim.nodes"
MIXER = Reference(f"{MIXING}:Mixer", {"name": "top"})
HERE = AttachedHere({"top": MIXER}, Allowance((MIXING,)), False, ("/mine",), "tcp/10.0.0.1:7000", "10.0.0.2", None)
ORDER: dict[str, Any] = {
    "name": "top",
    "process": "5f",
    "life": "newcomer",
    "request": "c4",
    "deployment": "live",
    "run": "5163af85",
    "roster": None,
    "modules": ["subprocess"],
    "preload": ["hierax_test_marker"],
    "seed": 3,
    "epochs": None,
    "staleness": 0,
    "rate_hz": None,
    "period_ms": 10.0,
    "rated": True,
    "hub": "tcp/203.0.113.9:1",
    "host": "0.0.0.0",
    "settings": {"plugins_loading": {"enabled": True}},
    "low_latency": False,
    "output": "/etc",
    "probes": [["top", {"target": "os:system", "parameters": {}}]],
    "import_paths": ["/theirs"],
    "checkpoint": "/root/.ssh/authorized_keys",
    "durability": "process",
    "owner": None,
    "on_uncertain_act": "repeat",
    "processes": {},
    "fault": "commit:1",
    "recorded": False,
}


def test_what_touches_this_machine_is_decided_here(tmp_path: Path) -> None:
    (order,) = read_orders([ORDER], "c4", HERE, tmp_path)
    assert (order.modules, order.preload, order.import_paths) == ((MIXING,), (MIXING,), ("/mine",))
    assert (order.hub, order.host, order.settings) == ("tcp/10.0.0.1:7000", "10.0.0.2", None)
    assert order.checkpoint == str(tmp_path / "top")
    assert (order.output, order.probes, order.owner) == ("", (), None)
    assert (order.budget_ms, order.period_ms, order.rated) == (None, 10.0, True)
    assert (order.process, order.run, order.seed, order.request, order.life) == ("5f", "5163af85", 3, "c4", "newcomer")


def test_who_trusts_a_launch_has_what_it_allows(tmp_path: Path) -> None:
    (order,) = read_orders([ORDER], "c4", replace(HERE, trusts=True), tmp_path)
    assert order.modules == (MIXING, "subprocess")
    assert (order.checkpoint, order.output, order.import_paths) == (str(tmp_path / "top"), "", ("/mine",))


@pytest.mark.parametrize(
    ("orders", "what"),
    [
        (None, "gave no orders, but "),
        ([3], "gave no orders, but "),
        ([], r"orders processes of .*; asked for were 'top'"),
        ([ORDER, ORDER], r"orders processes of .*; asked for were 'top'"),
        ([{**ORDER, "name": "bottom"}], r"orders processes of .*; asked for were 'top'"),
        ([{**ORDER, "run": "../../../tmp"}], "top: the launch's order says run: "),
        ([{**ORDER, "process": "a/b"}], "top: the launch's order says process: "),
        ([{**ORDER, "deployment": 3}], "top: the launch's order says deployment: "),
        ([{**ORDER, "lifetime_s": "20"}], "top: the launch's order says lifetime_s: '20'; expected float or int or "),
        ([{**ORDER, "lifetime_s": -1.0}], "top: the launch's order says lifetime_s: -1.0; expected a time"),
        ([{**ORDER, "lifetime_s": float("nan")}], "top: the launch's order says lifetime_s: nan; expected a time"),
        ([{**ORDER, "seed": "3"}], "top: the launch's order says seed: .*; expected int"),
        ([{**ORDER, "rated": None}], "top: the launch's order says rated: .*; expected bool"),
        ([{**ORDER, "low_latency": None}], "top: the launch's order says low_latency: .*; expected bool"),
    ],
)
def test_what_is_no_order_for_here(orders: Any, what: str, tmp_path: Path) -> None:
    with pytest.raises(HieraxError, match=what) as caught:
        read_orders(orders, "c4", HERE, tmp_path)
    assert "\n" not in str(caught.value)


def test_a_class_that_is_not_allowed_here_is_not_started(tmp_path: Path) -> None:
    with pytest.raises(NotAllowedError, match=r"^nodes\.top\.class: 'os:Mixer' may not be loaded"):
        read_orders([ORDER], "c4", replace(HERE, nodes={"top": Reference("os:Mixer")}), tmp_path)


# --- a launch that is none: it answers whatever it likes


class FalseLaunch:
    """Answers what a launch is asked, with orders of its own."""

    def __init__(self, file: Path) -> None:
        self.order = ORDER
        self.asked: list[str] = []
        self._file = file
        self._hub = Hub(Keys("live", "5163af85"), None, None)
        self._hub.serve(*[lambda question, reply: reply(self._answer(question))] * 2)
        self.endpoint = self._hub.endpoint

    def _answer(self, question: Any) -> Any:
        self.asked.append(question["ask"])
        if question["ask"] == "ps":
            settings = ['modules=["subprocess", "os"]', "kind=subprocess:run"]
            return {"file": str(self._file), "settings": settings, "run": "5163af85", "hierarchy": "live"}
        if question["ask"] == "change":
            return {"request": "c4", "orders": [self.order]}
        return {"refusal": "that was all"}

    def close(self) -> None:
        """End it."""
        self._hub.stop_serving()
        self._hub.close()


DEPLOYMENT = f"""\
hierarchy: live
world: world
parameters: {{kind: "{MIXING}:Mixer"}}
nodes:
  world: {{class: "{MIXING}:MixingWorld", parameters: {{name: world}}}}
"""


@pytest.fixture
def false_launch(tmp_path: Path) -> Iterator[FalseLaunch]:
    file = tmp_path / "live.yaml"
    file.write_text(DEPLOYMENT, encoding="utf-8")
    launch = FalseLaunch(file)
    yield launch
    launch.close()


def snippet(folder: Path, kind: str) -> str:
    path = folder / "top.yaml"
    node = f'nodes:\n  top: {{class: "{kind}", parameters: {{name: top}}}}\n'
    path.write_text(
        node + f'edges:\n  world -> top: {{sense: {{function: "{MIXING}:Mix", parameters: {{name: x}}}}}}\n'
    )
    return str(path)


def attached(folder: Path, launch: FalseLaunch, kind: str, *options: str) -> str:
    """What is said of attaching a node from a launch that is none."""
    source = snippet(folder, kind)
    done = said_by(folder, "attach", source, "--connect", launch.endpoint, "--here", "--host", "127.0.0.1", *options)
    assert done.returncode == 1, done
    assert done.stdout == ""
    assert done.stderr.count("error: ") == 1
    assert "Traceback" not in done.stderr
    return done.stderr


def test_a_launch_of_which_nothing_is_known_here_names_no_code(false_launch: FalseLaunch, tmp_path: Path) -> None:
    said = attached(tmp_path, false_launch, f"{MIXING}:Mixer")
    assert "--here: give the launch's deployment file by --deployment" in said
    assert "--trust" in said
    assert false_launch.asked == []


def test_a_false_launchs_settings_do_not_count_here(false_launch: FalseLaunch, tmp_path: Path) -> None:
    own = ("--deployment", str(tmp_path / "live.yaml"))
    said = attached(tmp_path, false_launch, "${kind}", *own)
    assert "nodes.top.class: 'subprocess:run' may not be loaded" in said
    assert "change" not in false_launch.asked


def test_a_false_launchs_orders_run_nothing_of_theirs(false_launch: FalseLaunch, tmp_path: Path) -> None:
    marker = tmp_path / "imported"
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "hierax_test_marker.py").write_text(f"from pathlib import Path\nPath({str(marker)!r}).touch()\n")
    run = {"import_paths": [str(theirs)], "output": str(tmp_path / "out"), "checkpoint": str(tmp_path / "chosen")}
    false_launch.order = {**ORDER, **run}
    said = attached(tmp_path, false_launch, f"{MIXING}:Mixer", "--deployment", str(tmp_path / "live.yaml"))
    assert "that was all" in said
    assert not marker.exists()
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.glob("chosen*"))
