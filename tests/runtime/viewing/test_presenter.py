from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from support.canvas import KeptCanvas

from hierax.runtime import Node, Step, Value
from hierax.runtime.core.showing import Graph, Points2D
from hierax.runtime.viewing.presenter import EPOCHS_OPEN, ViewPresenter
from hierax.runtime.viewing.views import ShowError
from hierax.schemas.rates import FROM_THE_BEGINNING, Turns
from hierax.schemas.roster import Reference, Roster, RosterEdge


class Level(Node):
    """Shows its belief, and the belief before."""

    def initial_belief(self) -> Value:
        return 0.0

    def metrics(self, belief: Value) -> Mapping[str, float]:
        return {"level": belief}

    def show(self, step: Step, before: Value) -> dict[str, Any]:
        things: dict[str, Any] = {"/level/now": step.belief, "before": str(before)}
        return {**things, "odd/now": step.belief} if step.epoch % 2 else things


def roster(*names: str) -> Roster:
    pairs = pairwise(names)
    return Roster(names[0], {name: Reference("a:B", {}) for name in names}, tuple(RosterEdge(*pair) for pair in pairs))


def step(epoch: int, belief: Value, attempt: int = 0) -> Step:
    return Step(epoch, attempt, epoch / 10, (), belief, (), (), "default", (), belief)


def presenter(*names: str, **options: Any) -> tuple[KeptCanvas, ViewPresenter]:
    canvas = KeptCanvas()
    shown = ViewPresenter(canvas, **options)
    shown.set_roster(roster(*names))
    return canvas, shown


def test_what_is_shown_no_more_is_cleared() -> None:
    canvas, shown = presenter("world")
    shown.step("world", Level(), step(1, 5.0))
    shown.step("world", Level(), step(2, 6.0))
    assert canvas.drawn[1].keys() == {
        "level/world/now",
        "world/before",
        "world/odd/now",
        "world/belief",
        "hierarchy",
    }
    assert canvas.cleared == {2: ["world/odd/now"]}


def test_the_belief_before_is_that_of_the_last_epoch_also_where_it_is_done_again() -> None:
    canvas, shown = presenter("world")
    told = []
    for number, belief, attempt in ((1, 5.0, 0), (2, 6.0, 0), (2, 7.0, 1), (4, 8.0, 0)):
        shown.step("world", Level(), step(number, belief, attempt), start=1.0)
        told.append(canvas.drawn[number]["world/before"].thing)
    assert told == ["1.0", "5.0", "5.0", "7.0"]


def test_the_hierarchy_is_drawn_when_all_nodes_are_done_with_an_epoch() -> None:
    canvas, shown = presenter("world", "arm", "top")
    for name, belief in (("world", 1.0), ("top", 3.0)):
        shown.step(name, Level(), step(1, belief))
    assert "hierarchy" not in canvas.drawn[1]
    shown.step("arm", Level(), step(1, 2.0))
    graph = canvas.drawn[1]["hierarchy"].thing
    assert isinstance(graph, Graph)
    assert graph.nodes == {"world": "world\nlevel 1", "arm": "arm\nlevel 2", "top": "top\nlevel 3"}
    assert list(graph.edges) == [("world", "arm"), ("arm", "top")]
    assert graph.places is not None
    assert [graph.places[name][1] for name in ("world", "arm", "top")] == [0.0, -110.0, -220.0]


def test_what_needs_several_nodes_is_shown_of_whole_epochs_alone() -> None:
    def together(steps: Mapping[str, Step]) -> dict[str, Any]:
        return {"/sum/of all": sum(each.belief for each in steps.values())}

    canvas, shown = presenter("world", "arm", together=together)
    for number in (1, 2):
        shown.step("world", Level(), step(number, 1.0))
    shown.step("arm", Level(), step(2, 2.0))
    shown.close()
    assert canvas.drawn[2]["sum/together/of all"].thing == 3.0
    assert "sum/together/of all" not in canvas.drawn[1]


def test_nodes_far_behind_are_not_waited_for() -> None:
    canvas, shown = presenter("world", "arm")
    for number in range(1, EPOCHS_OPEN + 2):
        shown.step("world", Level(), step(number, 1.0))
    assert "hierarchy" in canvas.drawn[1]
    assert "hierarchy" not in canvas.drawn[2]


def test_views_are_laid_out_again_only_where_there_are_others() -> None:
    canvas, shown = presenter("world", layout=((("level",),), (("hierarchy",),)))
    for number in (1, 2, 3):
        shown.step("world", Level(), step(number, 1.0))
    assert len(canvas.layouts) == 1
    assert canvas.names == [[["level"]], [["hierarchy"], ["world/before", "world/odd", "world/belief"]]]
    shown.epoch_took(3, 0.3, 0.25)
    shown.step("world", Level(), step(4, 1.0))
    assert len(canvas.layouts) == 2
    assert canvas.drawn[3]["epochs/took_ms"].thing == 250.0


def test_a_slip_in_the_layout_is_told_once() -> None:
    told: list[str] = []
    _, shown = presenter("world", layout=((("levle",),),), notify=told.append)
    for number in range(1, 60):
        shown.step("world", Level(), step(number, 1.0))
    shown.close()
    assert told == ["view.layout: nothing is shown in 'levle'; did you mean 'level'?"]


def test_nodes_that_have_gone_are_shown_no_more() -> None:
    canvas, shown = presenter("world", "arm")
    shown.step("arm", Level(), step(1, 1.0))
    shown.set_roster(roster("world"))
    shown.step("arm", Level(), step(2, 1.0))
    shown.step("world", Level(), step(2, 1.0))
    assert "level/arm/now" not in canvas.drawn[2]
    assert canvas.cleared[2] == ["arm/before", "arm/belief", "arm/odd/now", "level/arm/now"]
    graph = canvas.drawn[2]["hierarchy"].thing
    assert isinstance(graph, Graph)
    assert list(graph.nodes) == ["world"]


class Confused(Level):
    """Puts a point into a plot."""

    def show(self, step: Step, before: Value) -> dict[str, Any]:
        return {"/level/x": Points2D([])}


def test_a_view_holds_things_of_one_kind() -> None:
    _, shown = presenter("world", "arm")
    shown.step("world", Level(), step(1, 1.0))
    with pytest.raises(ShowError, match=r"^arm: the view 'level' cannot hold a picture as it holds a plot$"):
        shown.step("arm", Confused(), step(1, 1.0))


@pytest.mark.parametrize(
    ("given", "what"),
    [(lambda steps: steps["x"], "KeyError: 'x'"), (lambda steps: 3, "expected things by path, got int")],
)
def test_what_several_nodes_show_wrongly_is_told(given: Any, what: str) -> None:
    _, shown = presenter("world", together=given)
    with pytest.raises(ShowError) as caught:
        shown.step("world", Level(), step(1, 1.0))
    assert str(caught.value) == f"view.show in epoch 1: {what}"


def rated() -> Roster:
    """A world and a node above it that takes part in the epochs 1, 4, 7, …"""
    plain = roster("world", "slow")
    edges = tuple(replace(edge, delay=2) for edge in plain.edges)
    return replace(plain, edges=edges, turns={"slow": Turns(3, 1)}, timing=FROM_THE_BEGINNING)


def test_with_rates_each_node_is_shown_at_its_own_epochs_and_the_hierarchy_in_order() -> None:
    told: list[tuple[int, dict[str, int]]] = []

    def together(steps: Mapping[str, Step]) -> dict[str, Any]:
        told.append((max(step.epoch for step in steps.values()), {name: step.epoch for name, step in steps.items()}))
        return {}

    canvas = KeptCanvas()
    shown = ViewPresenter(canvas, together=together)
    shown.set_roster(rated())
    for epoch in range(1, 7):
        shown.step("world", Level(), step(epoch, float(epoch)))
    assert "hierarchy" not in canvas.drawn[1]  # slow has not told of it
    for epoch in (1, 4):
        shown.step("slow", Level(), step(epoch, float(epoch)))
    assert [epoch for epoch in sorted(canvas.drawn) if "slow/belief" in canvas.drawn[epoch]] == [1, 4]
    assert [epoch for epoch in sorted(canvas.drawn) if "hierarchy" in canvas.drawn[epoch]] == [1, 2, 3, 4, 5, 6]
    assert told == [(n, {"world": n, "slow": 1 if n < 4 else 4}) for n in range(1, 7)]
    graph = canvas.drawn[5]["hierarchy"].thing
    assert isinstance(graph, Graph)
    assert graph.nodes["world"] == "world\nepoch 5, with slow 1\nlevel 5"
    assert graph.nodes["slow"] == "slow\nepoch 4\nlevel 4"
