"""Changes of rosters as data: round trip, and errors that name the field."""

from __future__ import annotations

import copy
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from support.rosters import random_change, random_roster
from support.strategies import randoms

from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, RosterEdge, read_change
from hierax.schemas.values import decode_value, encode_value

LENS = Reference("robots.lens:Lens", {"focal_px": 525.8, "size": (640, 480)})
ATTACH = Attach({"lens": LENS, "eye": LENS}, (RosterEdge("lens", "eye", LENS), RosterEdge("world", "lens")))
DETACH = Detach("lens", cascade=True)
REPLACE = Replace("lens", LENS, (RosterEdge("world", "lens", context=LENS),))


@pytest.mark.parametrize("change", [ATTACH, Attach({}), DETACH, Detach("a.b"), REPLACE, Replace("lens", LENS)])
def test_a_change_comes_back(change: Change) -> None:
    assert read_change(decode_value(encode_value(change.plain()))) == change


@given(randoms)
def test_any_change_comes_back(rng: random.Random) -> None:
    change = random_change(rng, random_roster(rng))
    assert read_change(decode_value(encode_value(change.plain()))) == change


def test_the_order_of_nodes_does_not_show() -> None:
    other = Attach({"eye": LENS, "lens": LENS}, ATTACH.edges)
    assert encode_value(other.plain()) == encode_value(ATTACH.plain())


@pytest.mark.parametrize(
    ("change", "path", "value", "where", "what"),
    [
        (ATTACH, (), None, "change", "expected a map, got None"),
        (ATTACH, (), [1], "change", "expected a map, got a list"),
        (ATTACH, (), {}, "change.change", "expected attach, detach or replace, got None"),
        (ATTACH, ("change",), "atach", "change.change", "expected attach, detach or replace, got 'atach'"),
        (ATTACH, ("change",), "x" * 10**6, "change.change", "expected attach, detach or replace, got 'xxx"),
        (ATTACH, ("change",), [], "change.change", "expected attach, detach or replace, got a list"),
        (ATTACH, ("change",), np.zeros(2), "change.change", "expected attach, detach or replace, got a ndarray"),
        (ATTACH, ("change",), "detach", "change", "a map with the keys cascade, change, name"),
        (ATTACH, ("more",), 1, "change", "a map with the keys change, edges, nodes"),
        (ATTACH, ("nodes",), (), "change.nodes", "expected a map"),
        (ATTACH, ("nodes", "a b"), {}, "change.nodes", "'a b' is no node's name"),
        (ATTACH, ("nodes", "lens", "target"), "Lens", "change.nodes.lens.target", "expected 'package.module:name'"),
        (ATTACH, ("edges",), {}, "change.edges", "expected a list"),
        (ATTACH, ("edges", 1), None, "change.edges[1]", "keys context, lower, sense, task, upper"),
        (ATTACH, ("edges", 1, "upper"), "", "change.edges[1].upper", "is no node's name"),
        (DETACH, ("name",), 3, "change.name", "3 is no node's name"),
        (DETACH, ("cascade",), 1, "change.cascade", "expected true or false, got 1"),
        (REPLACE, ("name",), "../x", "change.name", "is no node's name"),
        (REPLACE, ("reference", "parameters"), None, "change.reference.parameters", "expected a map"),
        (REPLACE, ("edges",), 0, "change.edges", "expected a list"),
        (REPLACE, ("edges", 0, "sense"), "f", "change.edges[0].sense", "keys parameters, target"),
    ],
)
def test_errors_name_the_field(change: Change, path: tuple[str | int, ...], value: Any, where: str, what: str) -> None:
    whole: Any = {"change": copy.deepcopy(change.plain())}
    target = whole
    for key in ("change", *path)[:-1]:
        target = target[key]
    target[("change", *path)[-1]] = value
    with pytest.raises(SchemaError) as raised:
        read_change(whole["change"])
    assert raised.value.where == where
    assert what in raised.value.what
    assert len(str(raised.value)) < 200
