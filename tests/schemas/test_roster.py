"""Rosters: round trip, what the content's hash covers, errors."""

from __future__ import annotations

import copy
import random
from dataclasses import replace
from hashlib import blake2b
from typing import Any

import pytest

from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import Reference, Roster, RosterEdge
from hierax.schemas.values import decode_value, encode_value

CAMERA = Reference("robots.camera:Camera", {"focal_px": 525.8, "size": (640, 480)})
SEEN = Reference("robots.camera:seen")
ROSTER = Roster(
    world="world",
    nodes={"world": Reference("robots.scene:Scene"), "arm": CAMERA, "spatial": Reference("robots.physics:Scene")},
    edges=(
        RosterEdge("world", "arm", sense=SEEN),
        RosterEdge("arm", "spatial", sense=SEEN, context=CAMERA, task=Reference("robots.camera:task")),
    ),
    version=4,
    instances={"arm": 2},
)


def plain() -> Any:
    return copy.deepcopy(ROSTER.plain())


def test_a_roster_comes_back() -> None:
    back = Roster.read(decode_value(encode_value(ROSTER.plain())))
    assert back.plain() == ROSTER.plain()
    assert back.content_hash() == ROSTER.content_hash()
    assert [edge.name for edge in back.edges] == ["arm->spatial", "world->arm"]
    assert (back.world, back.version, back.instance("arm"), back.instance("world")) == ("world", 4, 2, 0)


def test_the_hash_is_of_the_encoded_content() -> None:
    assert ROSTER.content_hash() == blake2b(encode_value(ROSTER.content()), digest_size=32).digest()


def test_the_hash_ignores_version_instances_and_the_order_of_nodes_and_edges() -> None:
    rng = random.Random(5)
    for _ in range(10):
        names = rng.sample(sorted(ROSTER.nodes), 3)
        edges = tuple(rng.sample(ROSTER.edges, 2))
        other = replace(ROSTER, nodes={n: ROSTER.nodes[n] for n in names}, edges=edges, version=9, instances={})
        assert other.content_hash() == ROSTER.content_hash()


@pytest.mark.parametrize(
    "other",
    [
        replace(ROSTER, world="arm"),
        replace(ROSTER, nodes={**ROSTER.nodes, "more": SEEN}),
        replace(ROSTER, nodes={**ROSTER.nodes, "arm": SEEN}),
        replace(ROSTER, nodes={**ROSTER.nodes, "arm": replace(CAMERA, parameters={"focal_px": 525.7})}),
        replace(ROSTER, edges=ROSTER.edges[:1]),
        replace(ROSTER, edges=(ROSTER.edges[0], replace(ROSTER.edges[1], task=None))),
        replace(ROSTER, edges=(replace(ROSTER.edges[0], sense=None, context=SEEN), ROSTER.edges[1])),
    ],
)
def test_the_hash_covers_names_classes_parameters_and_edges(other: Roster) -> None:
    assert other.content_hash() != ROSTER.content_hash()


@pytest.mark.parametrize(
    ("path", "value", "where", "what"),
    [
        ((), None, "roster", "a map with the keys edges, instances, nodes, version, world"),
        (("world",), "", "roster.world", "is no node's name"),
        (("world",), 3, "roster.world", "is no node's name"),
        (("nodes",), [], "roster.nodes", "a map"),
        (("nodes", "a b"), {}, "roster.nodes", "'a b' is no node's name"),
        (("nodes", "arm"), None, "roster.nodes.arm", "keys parameters, target"),
        (("nodes", "arm", "more"), 1, "roster.nodes.arm", "keys parameters, target"),
        (("nodes", "arm", "target"), "Camera", "roster.nodes.arm.target", "expected 'package.module:name'"),
        (("nodes", "arm", "target"), "x" * 10**6, "roster.nodes.arm.target", "expected 'package.module:name'"),
        (("nodes", "arm", "parameters"), (), "roster.nodes.arm.parameters", "a map"),
        (("edges",), {}, "roster.edges", "a list"),
        (("edges", 1), 7, "roster.edges[1]", "keys context, lower, sense, task, upper"),
        (("edges", 1, "lower"), None, "roster.edges[1].lower", "is no node's name"),
        (("edges", 0, "sense"), "seen", "roster.edges[0].sense", "keys parameters, target"),
        (("version",), True, "roster.version", "a whole number from 0, got True"),
        (("version",), -1, "roster.version", "a whole number from 0, got -1"),
        (("instances",), (), "roster.instances", "a map"),
        (("instances", "arm"), "2", "roster.instances.arm", "a whole number from 0, got '2'"),
    ],
)
def test_errors_name_the_field(path: tuple[str | int, ...], value: Any, where: str, what: str) -> None:
    whole = {"roster": plain()}
    target: Any = whole
    for key in ("roster", *path)[:-1]:
        target = target[key]
    target[("roster", *path)[-1]] = value
    with pytest.raises(SchemaError) as raised:
        Roster.read(whole["roster"])
    assert raised.value.where == where
    assert what in raised.value.what
    assert len(str(raised.value)) < 200


def test_a_roster_without_a_field_is_refused() -> None:
    value = plain()
    del value["edges"]
    with pytest.raises(SchemaError, match="keys edges"):
        Roster.read(value)
