"""Nodes with rates come and go while a hierarchy runs: the run stays the one that `hierax run --at` repeats."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.live import Live, until

RATED = ("nodes.high.every=3", "nodes.high.offset=1", "edges.low -> high.delay=4", "edges.low -> high.gather=true")
EDGE = "    context: {function"


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path, pace_s=0.01, settings=RATED)
    yield launch
    launch.close()


def rated(path: str, turns: str, edge: str = "") -> str:
    """A snippet with these rates of its node, and of its edge."""
    text = Path(path).read_text().replace("{class:", f"{{{turns}, class:")
    Path(path).write_text(text.replace(EDGE, f"    {edge}\n{EDGE}") if edge else text)
    return path


def test_nodes_with_rates_are_attached_replaced_and_detached(live: Live) -> None:
    top = rated(live.snippet("top", "high"), "every: 7, offset: 2", "delay: 9")
    side = rated(live.snippet("side", "low"), "every: 2", "gather: true")
    quicker = rated(live.snippet("high", generation=1), "every: 2")
    slower = rated(live.snippet("top", "low", generation=2), "every: 11", "delay: 0")
    schedule = [
        f"{live.change('attach', top)}:attach:{top}",
        f"{live.change('attach', side)}:attach:{side}",
        f"{live.change('replace', 'high', quicker)}:replace:high:{quicker}",
    ]
    live.goes_on()
    schedule.append(f"{live.change('replace', 'top', slower)}:replace:top:{slower}")
    live.goes_on()
    schedule.append(f"{live.change('detach', 'side')}:detach:side")
    live.goes_on()
    schedule.append(f"{live.change('attach', side)}:attach:{side}")
    live.goes_on()
    live.is_repeated_by(*schedule)


def test_changes_beside_processes_that_die(live: Live) -> None:
    schedule = []
    for number, victim in enumerate(("high", "low", "world", "top")):
        path = rated(live.snippet("top", "high", number), f"every: {number + 2}", f"delay: {number}")
        change = ("attach", path) if not schedule else ("replace", "top", path)
        schedule.append(":".join([str(live.change(*change)), *change]))
        os.kill(live.run["nodes"][victim]["pid"], signal.SIGKILL)
        live.goes_on()
        until(lambda: all(node["pid"] for node in live.run["nodes"].values()), "all processes")
    live.is_repeated_by(*schedule)


def test_a_node_with_rates_that_would_fail_alone_is_refused(live: Live) -> None:
    path = rated(live.snippet("top", "high"), "every: 2, on_loss: detach")
    done = live.hierax("attach", path)
    assert done.returncode != 0
    assert "nodes.top.on_loss: detach means nothing here: where nodes have rates" in done.stderr
    live.is_repeated_by()


def test_what_an_attached_node_raises_ends_the_launch_with_its_line(live: Live) -> None:
    path = live.folder / "bad.yaml"
    node = 'nodes:\n  bad: {every: 2, class: "support.failing_nodes:Failing", '
    node += "parameters: {name: bad, operator: predict}}\n"
    edge = 'edges:\n  low -> bad: {sense: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: x}}}\n'
    path.write_text(node + edge)
    live.hierax("attach", str(path))
    assert live.launch.ends() == 1
    assert any("bad: predict" in line for line in live.launch.err), live.launch.err
