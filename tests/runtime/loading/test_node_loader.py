"""From versions of the roster to a node's wirings: what does not change is kept."""

from __future__ import annotations

from dataclasses import replace

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.schemas.roster import Reference, Roster, RosterEdge

MIXING = "hierax.runtime.sim.nodes"
MIX = Reference(f"{MIXING}:Mix", {"name": "x"})
OURS = Allowance((MIXING,))
FIRST = Roster(
    "world",
    {name: Reference(f"{MIXING}:{kind}", {"name": name}) for name, kind in (("world", "MixingWorld"), ("a", "Mixer"))},
    (RosterEdge("world", "a", sense=MIX),),
)


def mixer(name: str, generation: int = 0) -> Reference:
    return Reference(f"{MIXING}:Mixer", {"name": name, "generation": generation})


def test_a_node_that_a_version_does_not_touch_stays_as_it_is_under_the_new_version() -> None:
    loader = NodeLoader("a", OperatorSetting(), OURS)
    first = loader.wiring(FIRST)
    other = replace(
        FIRST,
        nodes={**FIRST.nodes, "b": mixer("b")},
        edges=(*FIRST.edges, RosterEdge("world", "b", sense=MIX)),
        version=1,
        instances={"world": 4},
    )
    second = loader.wiring(other)
    assert second.node is first.node
    assert (second.roster, second.below) == (1, {("world", "obs"): 4})


def test_new_neighbours_parameters_and_functions_are_taken_up() -> None:
    loader = NodeLoader("a", OperatorSetting(), OURS)
    first = loader.wiring(FIRST)
    above = replace(
        FIRST,
        nodes={**FIRST.nodes, "b": mixer("b")},
        edges=(*FIRST.edges, RosterEdge("a", "b", sense=MIX)),
        version=1,
    )
    second = loader.wiring(above)
    assert second.node is not first.node
    assert second.node.node is first.node.node
    assert (first.node.above, second.node.above) == ((), ("b",))
    assert [upper for upper, _ in second.sense] == ["b"]
    third = loader.wiring(replace(above, nodes={**above.nodes, "a": mixer("a", 1)}, version=2))
    assert third.node.node is not second.node.node
    assert third.node.above == ("b",)
    other = Reference(f"{MIXING}:Mix", {"name": "y"})
    fourth = loader.wiring(replace(above, edges=(FIRST.edges[0], RosterEdge("a", "b", sense=other)), version=3))
    assert [call for _, call in fourth.sense] != [call for _, call in third.sense]


def test_the_world_alone_knows_the_content_s_hash() -> None:
    assert NodeLoader("world", OperatorSetting(), OURS).wiring(FIRST).place.roster_hash == FIRST.content_hash()
    assert NodeLoader("a", OperatorSetting(), OURS).wiring(FIRST).place.roster_hash == bytes(32)
