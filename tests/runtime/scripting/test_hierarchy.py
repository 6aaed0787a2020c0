"""Hierarchies that are described in Python say what their deployment file says."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hierax
from hierax.nodes.servo import CameraNode, MeasuredPosition, MotionNode, SlidingWorld, camera_task, position
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment


def servo(**fields: Any) -> hierax.Hierarchy:
    """The shipped deployment, in Python."""
    hierarchy = hierax.Hierarchy("servo", epochs=60, **fields)
    hierarchy.add("world", SlidingWorld).add("camera", CameraNode).add("motion", MotionNode)
    hierarchy.join("world", "camera", sense=partial(MeasuredPosition, noise=0.1), task=camera_task)
    return hierarchy.join("camera", "motion", sense=position, context=position)


def test_it_is_the_shipped_file() -> None:
    assert servo().deployment().roster == read_deployment("servo").roster


def test_its_file_says_the_same(tmp_path: Path) -> None:
    hierarchy = servo(staleness=1, description="a € in Python").probe("camera", MotionNode)
    text = hierarchy.to_yaml(tmp_path / "servo.yaml")
    assert (tmp_path / "servo.yaml").read_text(encoding="utf-8") == text
    read, made = read_deployment(tmp_path / "servo.yaml"), hierarchy.deployment()
    assert (read.roster, read.probes, read.staleness) == (made.roster, made.probes, made.staleness)
    with pytest.raises(HieraxError, match=r"servo\.yaml: cannot be written: File exists"):
        hierarchy.to_yaml(tmp_path / "servo.yaml")


def test_parameters_are_as_a_file_has_them() -> None:
    inner = partial(
        MeasuredPosition, noise=np.float64(0.3), text="a ${b}", array=np.eye(2), pair=(1, 2), where=Path("x")
    )
    hierarchy = hierax.Hierarchy("servo").add("world", SlidingWorld).add("camera", CameraNode)
    edge = hierarchy.join("world", "camera", sense=partial(inner, noise=0.1)).deployment().roster.edges[0]
    assert edge.sense is not None
    given = {"noise": 0.1, "text": "a ${b}", "array": ((1.0, 0.0), (0.0, 1.0)), "pair": (1, 2), "where": "x"}
    assert edge.sense.parameters == given


def test_what_stands_at_the_top_may_be_tuples() -> None:
    layout = (("camera", ("errors", "epochs")), ("scene",))
    made = servo(modules=("somewhere.else",), view={"layout": layout}).deployment()
    assert "somewhere.else" in made.modules
    assert made.view.layout == ((("camera",), ("errors", "epochs")), (("scene",),))


class Mode(IntEnum):
    """A number with a name."""

    FAST = 1


@pytest.mark.parametrize(
    "value",
    ["1e5", "-.5", "0o17", "true", "no", "~", "2026-01-02", "1:30", "<<", "", "a: b", Mode.FAST, np.float64(20.0)],
)
def test_what_looks_like_something_else_is_in_the_file_what_it_was(value: object, tmp_path: Path) -> None:
    hierarchy = hierax.Hierarchy("servo").add("world", SlidingWorld).add("camera", CameraNode)
    hierarchy.join("world", "camera", sense=partial(MeasuredPosition, noise=value))
    hierarchy.to_yaml(tmp_path / "servo.yaml")
    edge = read_deployment(tmp_path / "servo.yaml").roster.edges[0]
    assert edge.sense is not None
    found = edge.sense.parameters["noise"]
    assert (found, isinstance(found, str)) == (value, isinstance(value, str))


def test_a_rate_may_be_a_number_of_numpys() -> None:
    assert "rate_hz: 20.0" in hierax.Hierarchy("servo").add("world", SlidingWorld, rate_hz=np.float64(20.0)).text()


def test_fields_of_nodes_and_edges_may_be_tuples_and_numbers_of_numpys() -> None:
    hierarchy = hierax.Hierarchy("servo", epochs=np.int64(3)).add("world", SlidingWorld)
    hierarchy.add("camera", CameraNode, every=np.int64(2), scheduling={"cpus": (0,)})
    made = hierarchy.join("world", "camera", sense=position, delay=np.int64(2)).deployment()
    assert (made.epochs, made.roster.turns["camera"].every, made.roster.edges[0].delay) == (3, 2, 2)
    assert made.terms["camera"].scheduling == {"policy": "other", "priority": 1, "cpus": [0]}


def test_a_text_of_numpys_is_a_text() -> None:
    hierarchy = hierax.Hierarchy("a").add("world", partial(SlidingWorld, name=np.str_("${b}")))
    assert "name: $${b}" in hierarchy.text()


def world_or_world(start: Unknown = None) -> SlidingWorld | OtherWorld:  # type: ignore[name-defined] # noqa: F821
    return SlidingWorld()


class OtherWorld(SlidingWorld):
    """Another world."""


def test_what_a_function_takes_need_not_be_known_where_it_is_named() -> None:
    with hierax.run(hierax.Hierarchy("a").add("world", world_or_world), epochs=2) as run:
        assert len(list(run)) == 2


def inside() -> Any:
    """A class that has no name at the top of a module."""

    class Inner(CameraNode):
        pass

    return Inner


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: hierax.Hierarchy("a").add("n", inside()), r"node 'n': .*Inner cannot be found by its name"),
        (lambda: hierax.Hierarchy("a").add("n", lambda: None), r"node 'n': .*cannot be found by its name"),
        (lambda: hierax.Hierarchy("a").add("n", partial(CameraNode, 3)), r"node 'n': give parameters by name: partial"),
        (
            lambda: hierax.Hierarchy("a").add("n", partial(CameraNode, x=object())),
            r"node 'n': x: expected text, numbers",
        ),
        (lambda: hierax.Hierarchy("a").add("n", "CameraNode"), r"node 'n': expected a class, a function"),
        (lambda: servo().add("world", CameraNode), r"there is a node 'world' already"),
        (lambda: servo().add("second", SlidingWorld), r"node 'second' is a World, and 'world' is one already"),
        (lambda: servo(nodes={}), r"hierarchy 'servo': nodes: expected it by `add`"),
        (lambda: servo(hierarchy="b"), r"hierarchy 'servo': hierarchy: expected it as the name"),
        (lambda: servo().add("n", CameraNode, **{"class": "a:B"}), r"node 'n': class: expected it in its own place"),
        (
            lambda: servo().add("n", partial(CameraNode, x=1), parameters={"y": 2}),
            r"node 'n': parameters: expected it by `functools\.partial` alone",
        ),
        (lambda: servo().join("world", "camera"), r"there is an edge 'world -> camera' already"),
        (lambda: hierax.Hierarchy("a").add("n", CameraNode).deployment(), r"hierarchy 'a' has no world"),
        (
            lambda: servo(stalness=1).deployment(),
            r"hierarchy 'servo': stalness: unknown field; did you mean 'staleness'",
        ),
        (
            lambda: servo().add("n", CameraNode, on_los="x").deployment(),
            r"nodes\.n\.on_los: unknown field; did you mean",
        ),
        (
            lambda: servo().join("camera", "n").deployment(),
            r"hierarchy 'servo': edges\.camera -> n: there is no node 'n'",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line(make: Callable[[], object], what: str) -> None:
    with pytest.raises(HieraxError, match=what) as caught:
        make()
    assert "\n" not in str(caught.value)
