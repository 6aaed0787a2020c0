from __future__ import annotations

import pytest

from hierax.runtime.deployment.deployment import edge_name, field_text, longest_key, normal_path


def test_a_path_as_text() -> None:
    assert field_text(("nodes", "world", "parameters", "list", 2, "x")) == "nodes.world.parameters.list[2].x"
    assert field_text(()) == ""


@pytest.mark.parametrize("text", ["a -> b", "a->b", " a  ->  b "])
def test_an_edge_has_one_name(text: str) -> None:
    assert edge_name(text) == "a -> b"


def test_one_way_to_write_a_path() -> None:
    assert normal_path("edges.a->b.sense") == "edges.a -> b.sense"
    assert normal_path(" probes[0].node ") == "probes.0.node"
    assert normal_path("nodes.a->b") == "nodes.a->b"


@pytest.mark.parametrize(
    ("value", "rest", "key"),
    [
        ({"cam": 1, "cam.left": 2}, "cam.left.class", "cam.left"),
        ({"cam": 1, "cam.left": 2}, "cam.leftmost", "cam"),
        ({"cam": 1}, "camera", None),
        ([1, 2], "1.x", 1),
        ([1, 2], "2", None),
        ([1, 2], "01", None),
        ([1, 2], "9" * 5000, None),
        ("text", "x", None),
        (None, "x", None),
    ],
)
def test_the_longest_key_that_fits(value: object, rest: str, key: object) -> None:
    assert longest_key(value, rest) == key
