from __future__ import annotations

import pytest

from hierax.runtime.deployment.deployment import Document, Keys
from hierax.runtime.deployment.tree import read_tree

TEXT = """\
parameters: {noise: 1}
nodes:
  cam: {class: a:b}
  cam.left:
    class: a:c
    parameters: {noise: "${noise}", gains: [1, 2]}
edges:
  cam -> cam.left: {sense: a:f}
probes:
  - {node: cam}
"""


def document() -> Document:
    tree = read_tree(TEXT, "f.yaml")
    return Document("f.yaml", tree.value, tree.lines)


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("nodes.cam.class", ("nodes", "cam", "class")),
        ("nodes.cam.left.class", ("nodes", "cam.left", "class")),
        ("nodes.cam.left.parameters.gains[1]", ("nodes", "cam.left", "parameters", "gains", 1)),
        ("nodes.cam.parameters.noise", ("nodes", "cam", "parameters.noise")),
        ("edges.cam->cam.left.sense.function", ("edges", "cam -> cam.left", "sense")),
        ("probes[0].class", ("probes", 0, "class")),
        ("probes[7].class", ("probes", "7.class")),
        ("", ()),
    ],
)
def test_a_path_as_keys(text: str, keys: Keys) -> None:
    assert document().keys(text) == keys


@pytest.mark.parametrize(
    ("text", "is_there"),
    [
        ("nodes.cam.class", True),
        ("nodes.cam.left.parameters.noise", True),
        ("nodes.other.class", False),
        ("nodes", False),
        ("edges.cam->cam.left.sense", True),
        ("edges.cam->other.sense", False),
        ("probes[0].class", False),
        ("observe in epoch 3", False),
        ("", False),
    ],
)
def test_whether_the_node_or_edge_of_a_path_is_there(text: str, is_there: bool) -> None:
    assert document().has_part(text) == is_there


@pytest.mark.parametrize(
    ("keys", "place"),
    [
        (("nodes", "cam", "class"), "f.yaml:3"),
        (("nodes", "cam", "parameters"), "f.yaml:3"),
        (("nodes", "cam.left", "class"), "f.yaml:5"),
        (("zenoh",), "f.yaml:1"),
    ],
)
def test_where_a_value_stands(keys: Keys, place: str) -> None:
    assert document().where(keys) == place


def test_what_was_set_has_no_line_any_more() -> None:
    changed = document()
    changed.changed["nodes", "cam.left"] = "nodes.cam.left={}"
    assert changed.where(("nodes", "cam.left", "class")) == "--set nodes.cam.left={}"
    assert changed.where(("nodes", "cam", "class")) == "f.yaml:3"


def test_an_error_names_the_parameter_that_a_value_came_from() -> None:
    taken = document()
    taken.origins["nodes", "cam.left", "parameters", "noise"] = "noise"
    error = taken.error(("nodes", "cam.left", "parameters", "noise"), "expected more")
    assert str(error) == "f.yaml:6: nodes.cam.left.parameters.noise: expected more (from ${noise}, f.yaml:1)"
    assert (error.place, error.field) == ("f.yaml:6", "nodes.cam.left.parameters.noise")
