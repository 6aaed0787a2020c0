"""What a tower's nodes show: symbols, rule or plan, skill and scene, by the views' names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.display import gripper_lines
from hierax.nodes.tower.builder import Builder, TeleoReactive
from hierax.nodes.tower.planner import Planner
from hierax.nodes.tower.rules import LOOKED_FOR
from hierax.nodes.tower.skills import SkillsNode
from hierax.nodes.tower.symbols import Symbols
from hierax.nodes.tower.world import TowerWorld
from hierax.runtime import Step
from hierax.runtime.core.showing import Box, Curve, Graph, Image
from hierax.runtime.viewing.views import placed

ON = Symbols(
    ((3, 1),),
    (1, 2),
    (5,),
    4,
    {"on 3 1": 0.97, "on_table 1": 0.99, "on_table 2": 0.4, "holding 4": 0.98, "unknown 5": 1.0},
)


def step_of(belief: Any, sensed: Any = None) -> Step:
    return Step(7, 0, 0.3, (), belief if sensed is None else sensed, (), (), "default", (), belief)


def builder_shows(node: Builder, symbols: Symbols = ON, **wish: Any) -> Any:
    belief = {**node.initial_belief(), "symbols": symbols._asdict(), **wish}
    things = node.show(step_of(belief), None)
    placed("builder", things, "here")  # paths and things are such that a viewer takes them
    return things


def test_symbols_are_a_graph_of_what_is_on_what() -> None:
    graph = builder_shows(TeleoReactive([1, 3, 4], 5))["towers"]
    assert isinstance(graph, Graph)
    assert set(graph.edges) == {("3", "1"), ("1", "table"), ("2", "table"), ("5", "unknown"), ("4", "hand")}
    assert graph.nodes["3"] == "3\n0.97"
    assert graph.places is not None
    assert graph.places["3"][0] == graph.places["1"][0]
    assert graph.places["3"][1] < graph.places["1"][1] < graph.places["table"][1]


def test_at_the_beginning_nothing_is_on_anything() -> None:
    graph = builder_shows(TeleoReactive([1, 2], 2), Symbols((), (), (), None, {}))["towers"]
    assert not graph.edges
    assert set(graph.nodes) == {"1", "2", "table"}


def test_certainties_are_curves_and_words() -> None:
    things = builder_shows(TeleoReactive([1, 3, 4], 5), rule="make tower 1 3 4 > move 4 onto 3 > take", cube=4, onto=3)
    assert isinstance(things["certainty/on 3 1"], Curve)
    assert things["certainty/on 3 1"].value == 0.97
    assert "**make tower 1 3 4 > move 4 onto 3 > take**: 4 onto 3" in things["why"]
    assert "tower 1 3 4: 2 of 3 stand" in things["why"]
    assert "| on 3 1 | yes | 0.970 |" in things["why"]
    assert "| on_table 2 | yes | 0.400 |" in things["why"]
    assert "| clear 3 | yes | below 0.01 |" in things["why"]
    assert "| holding 4 | yes | 0.980 |" in things["why"]
    assert "| unknown 5 | yes | 1.000 |" in things["why"]
    assert "clear 1" not in things["why"]
    assert "plan" not in things["why"]


def test_a_planner_shows_its_plan() -> None:
    pytest.importorskip("clingo", reason="the extra [plan] is not installed")
    plan = {"plan": ((2, 0), (5, -2), (5, 3)), "expects": ()}
    things = builder_shows(Planner([1, 3, 5], 5), rule="planned", cube=2, onto=0, **plan)
    assert "plan: 2 onto the table, look for 5, 5 onto 3" in things["why"]


def test_the_skill_is_told_with_what_it_reaches_for() -> None:
    node = SkillsNode()
    belief = node.initial_belief()
    assert set(node.show(step_of(belief), None)) == {"skill"}
    hand = {"gripper": np.eye(4), "width": 0.05}
    moving = {
        **belief,
        "phase": "carry",
        "since_s": 0.1,
        "target": 3,
        "goal": (3, 0),
        "refused": (3, 1),
        "asked": (3, 1),
        "hand": hand,
    }
    things = node.show(step_of({**moving, "gripper": np.eye(4), "place": np.eye(4), "box_width": 0.04}), None)
    placed("skills", things, "here")
    assert set(things) == {"skill", "/scene/gripper", "/scene/grasp", "/scene/place"}
    for told in (
        "**place on the table 3**",
        "carry for 0.2 s",
        "for: 3 onto the table",
        "given up: 3 onto 1",
        "50 mm between",
    ):
        assert told in things["skill"]
    aside = {**moving, "gripper": np.eye(4), "place": np.eye(4), "box_width": 0.04, "refused": (2, 1)}
    shown = node.show(step_of(aside), None)["skill"]
    assert "to make room for: 2 onto 1" in shown
    assert "**move out of the way 3**" in shown
    looks = {**belief, "goal": (2, LOOKED_FOR), "asked": (2, LOOKED_FOR), "bodies": ({"id": 2, "status": "lost"},)}
    assert "**look 2**\n\nwatch" in node.show(step_of(looks), None)["skill"]
    seen = {**looks, "bodies": ({"id": 2, "status": "tracked"},)}
    assert "**look 2**, done" in node.show(step_of(seen), None)["skill"]


def test_a_gripper_is_as_wide_as_its_fingers_are_apart() -> None:
    lines = gripper_lines(np.eye(4), 0.06)
    assert float(np.ptp(lines[:2, 0, 1])) == pytest.approx(0.06)
    assert lines[..., 2].max() == 0.0  # fingers point along z


def test_the_world_is_seen_from_beside_with_whoever_reaches_in() -> None:
    world = TowerWorld([1, 2], cubes=2)
    belief = world.initial_belief()
    hand = {"pose": np.eye(4), "size": np.full(3, 0.05), "colour": (200, 150, 120)}
    things = world.show(step_of(belief, {**belief, "obstacles": (hand,)}), None)
    placed("world", things, "here")
    assert isinstance(things["/beside/picture"], Image)
    assert np.asarray(things["/beside/picture"].pixels).std() > 10.0
    assert isinstance(things["/scene/person/0"], Box)
    assert {"/scene/true/1", "/scene/true/2", "metrics/towers_done"} <= set(things)
