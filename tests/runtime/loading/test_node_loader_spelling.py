"""Methods that are nearly operators."""

from __future__ import annotations

from importlib import import_module
from pkgutil import walk_packages

import pytest

import hierax.nodes
from hierax.runtime import Elements, Node, Value, World
from hierax.runtime.loading.node_loader import misspelt_operators


class Helped(Node):
    """Its helpers are named as they like."""

    def initial_belief(self) -> Value:
        return 0

    def observe(self, observations: Elements, belief: Value) -> Value:
        return self.observed(observations)

    def observed(self, observations: Elements) -> Value:
        return len(observations)

    def compute(self) -> int:
        return 1

    def _predic(self) -> None:
        return


class Mistyped(Helped):
    """Its prediction is never called."""

    def predcit(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief


class Late(Helped, World):
    """It would never end."""

    def finish(self, belief: Value) -> bool:
        return True


class Observing(Node):
    """The common one."""

    def initial_belief(self) -> Value:
        return 0

    def observ(self, observations: Elements, belief: Value) -> Value:
        return 1


@pytest.mark.parametrize(
    ("node", "wrong", "right"),
    [(Mistyped, "predcit", "predict"), (Late, "finish", "finished"), (Observing, "observ", "observe")],
)
def test_a_method_that_is_nearly_an_operator(node: type[Node], wrong: str, right: str) -> None:
    (found,) = misspelt_operators(node)
    where = f"{__name__}:{node.__name__}"
    assert found.startswith(f"{where} defines {wrong!r}, which nothing calls; did you mean {right!r}?")


def test_helpers_are_left_alone() -> None:
    assert misspelt_operators(Helped) == []


def test_no_shipped_node_is_named() -> None:
    looked_at = 0
    for found in walk_packages(hierax.nodes.__path__, "hierax.nodes."):
        for kind in vars(import_module(found.name)).values():
            if isinstance(kind, type) and issubclass(kind, Node):
                looked_at += 1
                assert misspelt_operators(kind) == []
    assert looked_at > 20
