"""The builder: symbols of what is seen, and what is to be done next for the towers that are asked for.

There are three, with the same belief, so that one may take the place of another while a tower grows: one that goes by
rules, `TeleoReactive`, and two that go by a plan (`hierax.nodes.tower.planner`)."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.tracker import read_scene
from hierax.nodes.tower.display import builder_things
from hierax.nodes.tower.goals import read_towers
from hierax.nodes.tower.rules import NO_PLAN, Plan, Wish, height_of, is_done, order_of, wish_of
from hierax.nodes.tower.skills import SkillsNode
from hierax.nodes.tower.symbols import NOTHING, Symbols, Told, symbols_after
from hierax.nodes.tower.tasks import task_of
from hierax.runtime import Elements, Node, Step, Value
from hierax.runtime.core.node import Policy
from hierax.runtime.core.showing import Things

_BY_SYMBOL = ("certainty", "doubts")  # maps of `Symbols`


class Builder(Node):
    """Believes in symbols, and wishes for one move after the other.

    The belief: ``symbols``, a map of `Symbols`' fields; ``rule``, ``cube`` and ``onto`` of the wish (``cube`` is None
    where nothing is to be done); ``plan``, the steps that are to follow, with this one as the first, as
    `hierax.nodes.tower.rules.Step` has them; and ``expects``, what each cube is on when this one begins, pairs. Both
    are empty where there is no plan.

    Args: tower: as `hierax.nodes.tower.goals.read_towers` has it; cubes: how many there are.
    Raises ValueError: the tower cannot be built of them."""

    initial_policy = "build"

    def __init__(self, tower: Any, cubes: int = CUBES) -> None:
        self.towers = read_towers(tower, cubes)
        self.cubes = tuple(range(1, cubes + 1))

    @abstractmethod
    def decided(self, symbols: Symbols, skill: Mapping[str, Any], belief: Value) -> tuple[Wish, Plan]:
        """What is wished for where these symbols hold and the skill is as told, after what was believed before;
        and the plan."""

    def initial_belief(self) -> Value:
        """Nothing is known yet, and nothing is to be done."""
        return {"symbols": NOTHING._asdict(), **Wish("look")._asdict(), **NO_PLAN._asdict()}

    def take_over(self, belief: Value) -> Value:
        """The belief of whichever builder was there before. Its maps by symbol have other keys from scene to scene.

        Raises ValueError: it is no builder's belief."""
        given = belief
        if isinstance(belief, dict) and isinstance(belief.get("symbols"), dict):
            maps: Value = {name: {} for name in _BY_SYMBOL if isinstance(belief["symbols"].get(name), dict)}
            given = {**belief, "symbols": {**belief["symbols"], **maps}}
        super().take_over(given)
        return belief

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ: symbols of the scene and the skill as `hierax.nodes.tower.skills.scene_and_skill` tells them, and what is
        wished for by them."""
        if not observations:
            return belief
        bodies, hand, carried = read_scene(observations)
        skill = next(item["skill"] for item in observations if "skill" in item)
        told = Told(bodies, carried, skill["holding"], hand["gripper"], hand["width"], skill["looks"])
        symbols = symbols_after(Symbols(**belief["symbols"]), told)
        wish, plan = self.decided(symbols, skill, belief)
        return {"symbols": symbols._asdict(), **wish._asdict(), **plan._asdict()}

    def policies(self) -> Mapping[str, Policy]:
        """Π: to build."""
        return {self.initial_policy: wished}

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """Towers that stand by what the builder believes, cubes that stand in their places, and cubes unknown."""
        symbols = Symbols(**belief["symbols"])
        done = sum(is_done(tower, symbols) for tower in self.towers)
        stacked = sum(height_of(order_of(tower, symbols), symbols) for tower in self.towers)
        return {"done": float(done), "stacked": float(stacked), "unknown": float(len(symbols.unknown))}

    def show(self, step: Step, before: Value) -> Things:
        """The symbols with their certainty, the rule or plan, and the figures."""
        return {**builder_things(step.belief, self.towers, self.cubes), **super().show(step, before)}


class TeleoReactive(Builder):
    """Builds towers by rules that are gone through in every epoch (`hierax.nodes.tower.rules`); its plan is empty."""

    def decided(self, symbols: Symbols, skill: Mapping[str, Any], belief: Value) -> tuple[Wish, Plan]:
        return wish_of(self.towers, symbols), NO_PLAN


REACTIVE, PLANNER, OPEN_LOOP = "reactive", "planner", "open_loop"


def builder(builder: str, tower: Any, cubes: int = CUBES) -> Builder:
    """A builder by its name, ``reactive``, ``planner`` or ``open_loop``; the rest as `Builder` has it.

    Raises ValueError: there is none of that name."""
    from hierax.nodes.tower.planner import OpenLoop, Planner  # it builds upon this module

    _check_name(builder)
    kinds: dict[str, type[Builder]] = {REACTIVE: TeleoReactive, PLANNER: Planner, OPEN_LOOP: OpenLoop}
    return kinds[builder](tower, cubes)


def skills_for(builder: str) -> SkillsNode:
    """The skills node for a builder by its name: below one that does not look, neither does the hand.

    Raises ValueError: there is none of that name."""
    _check_name(builder)
    return SkillsNode(once=builder == OPEN_LOOP)


def _check_name(builder: str) -> None:
    names = (REACTIVE, PLANNER, OPEN_LOOP)
    if builder not in names:
        raise ValueError(f"builder is {builder!r}; expected one of {', '.join(names)}")


def wished(belief: Value) -> Elements:
    """The one action, a task as `hierax.nodes.tower.tasks` has it; none where there is nothing to be done."""
    return () if belief["cube"] is None else (task_of(belief["cube"], belief["onto"]),)


def what_stands(belief: Value) -> Elements:
    """ϱ of the builder: what has to be true next, {"stands": ids of the cubes that stand somewhere}."""
    symbols = Symbols(**belief["symbols"])
    return ({"stands": tuple(sorted({*symbols.below, *symbols.on_table}))},)


def asked_for(actions: Elements) -> Elements:
    """ψ of the builder: its wishes are the tasks of the node below."""
    return actions
