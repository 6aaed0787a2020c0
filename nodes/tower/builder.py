"""The builder: symbols of what is seen, and what is to be done next for the towers that are asked for."""

from collections.abc import Mapping
from typing import Any

from hierax.nodes.picking.layout import SIDES_M
from hierax.nodes.picking.phases import WATCH
from hierax.nodes.tower.goals import read_towers
from hierax.nodes.tower.rules import TABLE, Wish, height_of, is_done, wish_of
from hierax.nodes.tower.symbols import NOTHING, Symbols, symbols_after
from hierax.runtime import Elements, Node, Value
from hierax.runtime.core.node import Policy


class TeleoReactive(Node):
    """Builds towers by rules that are gone through in every epoch (`hierax.nodes.tower.rules`).

    The belief: ``symbols``, a map of `Symbols`' fields, and ``rule``, ``cube`` and ``onto`` of the wish; ``cube`` is
    None where nothing is to be done.

    Args: tower: as `hierax.nodes.tower.goals.read_towers` has it; cubes: how many there are.
    Raises ValueError: the tower cannot be built of them."""

    initial_policy = "build"

    def __init__(self, tower: Any, cubes: int = len(SIDES_M)) -> None:
        self._towers = read_towers(tower, cubes)

    def initial_belief(self) -> Value:
        """Nothing is known yet, and nothing is to be done."""
        return self._belief(NOTHING, Wish("look"))

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ: symbols of the scene and the skill as `hierax.nodes.tower.skills.scene_and_skill` tells them, and the rule
        that fits them."""
        if not observations:
            return belief
        bodies = tuple(item for item in observations if "pose" in item)
        skill = next(item["skill"] for item in observations if "skill" in item)
        looking = skill["phase"] == WATCH
        symbols = symbols_after(Symbols(**belief["symbols"]), bodies, skill["holding"], looking)
        return self._belief(symbols, wish_of(self._towers, symbols))

    def policies(self) -> Mapping[str, Policy]:
        """Π: to build."""
        return {self.initial_policy: wished}

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """Towers that stand by what the builder believes, cubes that stand in their places, and cubes unknown."""
        symbols = Symbols(**belief["symbols"])
        done = sum(is_done(tower, symbols) for tower in self._towers)
        stacked = sum(height_of(tower, symbols) for tower in self._towers)
        return {"done": float(done), "stacked": float(stacked), "unknown": float(len(symbols.unknown))}

    def _belief(self, symbols: Symbols, wish: Wish) -> Value:
        return {"symbols": symbols._asdict(), **wish._asdict()}


def wished(belief: Value) -> Elements:
    """The one action: what is to be moved where, {"cube": id, "onto": id, or 0 for the table}; none where there is
    nothing to be done."""
    return () if belief["cube"] is None else ({"cube": belief["cube"], "onto": belief["onto"] or TABLE},)


def what_stands(belief: Value) -> Elements:
    """ϱ of the builder: what has to be true next, {"stands": ids of the cubes that stand somewhere}."""
    symbols = Symbols(**belief["symbols"])
    return ({"stands": tuple(sorted({*symbols.below, *symbols.on_table}))},)


def asked_for(actions: Elements) -> Elements:
    """ψ of the builder: its wishes are the tasks of the node below."""
    return actions
