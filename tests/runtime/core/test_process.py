"""Definitions 3 to 6 on hierarchies small enough to compute by hand."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import HierarchyError, OperatorError
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, sensing_update, update


class Teller(Node):
    """Its belief is a text that tells what was done to it, in order.

    With belief s: observe gives ``s<O>``, predict ``s[C|A]``; the policy named p acts ``p(s)``.
    """

    def __init__(self, start: str, policies: str = "default") -> None:
        self.start = start
        self.names = policies.split()

    def initial_belief(self) -> Value:
        return self.start

    def observe(self, observations: Elements, belief: Value) -> Value:
        return f"{belief}<{' '.join(observations)}>"

    def select_policy(self, tasks: Elements) -> str:
        return self.names[len(tasks) % len(self.names)]

    def policies(self) -> Mapping[str, Callable[..., Elements]]:
        return {name: self._policy(name) for name in self.names}

    @staticmethod
    def _policy(name: str) -> Callable[..., Elements]:
        return lambda belief: (f"{name}({belief})",)

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return f"{belief}[{' '.join(context)}|{' '.join(actions)}]"


class World0(Teller, World):
    """The world; an epoch takes 0.5 s."""

    def time_s(self, belief: Value, epoch: int) -> float:
        return 0.5 * epoch


def once(name: str) -> Callable[[Value], Elements]:
    """Gives one element."""
    return lambda value: (f"{name}:{value if isinstance(value, str) else ' '.join(value)}",)


def pair(**kinds: Callable[..., Elements] | None) -> Hierarchy:
    return Hierarchy({"w": World0("w"), "n": Teller("n")}, "w", [Edge("w", "n", **kinds)])


def beliefs(active: ActiveHierarchy) -> dict[str, str]:
    return {name: state.belief for name, state in active.states.items()}


def test_definition_3_initially_no_actions() -> None:
    active = ActiveHierarchy.initial(pair())
    assert beliefs(active) == {"w": "w", "n": "n"}
    assert {state.policy for state in active.states.values()} == {"default"}
    assert {state.actions for state in active.states.values()} == {()}
    assert active.epoch == 0


def test_one_update_by_hand() -> None:
    active = update(ActiveHierarchy.initial(pair(sense=once("o"), task=once("t"), context=once("c"))))
    n, w = active.states["n"], active.states["w"]
    # n senses o:w, acts on its belief before it predicts, and has no context.
    assert n.actions == ("default(n<o:w>)",)
    assert n.belief == "n<o:w>[|default(n<o:w>)]"
    # w senses nothing; its context is of n's belief after n's prediction, its action of its own before.
    assert w.actions == ("default(w)",)
    assert w.belief == f"w[c:{n.belief}|default(w)]"
    assert active.epoch == 1


def test_an_edge_without_functions_gives_empty_sets() -> None:
    assert beliefs(update(ActiveHierarchy.initial(pair()))) == {"n": "n<>[|default(n<>)]", "w": "w[|default(w)]"}


def test_definition_4_the_world_senses_nothing() -> None:
    active = ActiveHierarchy.initial(pair())
    assert sensing_update(active, "w", 1, 0.0) is active


def test_definition_4_senses_beliefs_after_their_own_sensing_update() -> None:
    hierarchy = Hierarchy(
        {"w": World0("w"), "a": Teller("a"), "b": Teller("b")},
        "w",
        [Edge("w", "a", sense=once("o")), Edge("a", "b", sense=once("o"))],
    )
    active = sensing_update(ActiveHierarchy.initial(hierarchy), "a", 1, 0.0)
    active = sensing_update(active, "b", 1, 0.0)
    assert active.states["b"].belief == "b<o:a<o:w>>"


def test_definition_5_the_task_is_of_the_parents_new_actions() -> None:
    tasks: list[Elements] = []

    class Listens(World0):
        def select_policy(self, tasks_: Elements) -> str:
            tasks.append(tasks_)
            return "default"

    hierarchy = Hierarchy({"w": Listens("w"), "n": Teller("n")}, "w", [Edge("w", "n", task=once("t"))])
    update(ActiveHierarchy.initial(hierarchy))
    assert tasks == [(), ("t:default(n<>)",)]  # the first is the check of λ(∅) when the node is bound


def test_definition_5_a_root_keeps_its_policy_and_is_not_asked() -> None:
    class Root(Teller):
        asked = 0

        def select_policy(self, tasks: Elements) -> str:
            Root.asked += 1
            return super().select_policy(tasks)

    hierarchy = Hierarchy({"w": World0("w"), "n": Root("n", "default other")}, "w", [Edge("w", "n")])
    active = ActiveHierarchy.initial(hierarchy)
    kept = active.with_state("n", type(active.states["n"])("n", "other"))
    after = update(kept)
    assert after.states["n"].policy == "other"
    assert after.states["n"].actions == ("other(n<>)",)
    assert Root.asked == 1  # when the node was bound


def test_definition_5_no_task_means_the_initial_policy_again() -> None:
    hierarchy = Hierarchy({"w": World0("w", "default busy"), "n": Teller("n")}, "w", [Edge("w", "n")])
    active = ActiveHierarchy.initial(hierarchy)
    busy = active.with_state("w", type(active.states["w"])("w", "busy"))
    assert update(busy).states["w"].policy == "default"


def diamond(sense: Any = None, task: Any = None, context: Any = None) -> Hierarchy:
    """w below a and b, both below t; names against the order in which edges are given."""
    nodes = {"w": World0("w"), "b": Teller("b"), "a": Teller("a"), "t": Teller("t")}
    edges = [Edge(lower, upper, sense, task, context) for lower, upper in ("bt", "wb", "at", "wa")]
    return Hierarchy(nodes, "w", edges)


def test_unions_go_by_name_then_as_given_and_keep_doubles() -> None:
    def two(value: Value) -> Elements:
        return ("same", f"z{value[0]}", f"y{value[0]}")

    active = update(ActiveHierarchy.initial(diamond(sense=two, context=two)))
    assert active.states["t"].belief.startswith("t<same za ya same zb yb>")
    assert active.states["w"].belief.startswith("w[same za ya same zb yb|")


def test_ticks_tell_epoch_time_names_and_neighbours() -> None:
    ticks: list[tuple[Any, ...]] = []

    def told(tick: Tick) -> None:
        ticks.append((tick.seed, tick.subject, tick.operator, tick.epoch, tick.time_s, tick.below, tick.above))

    class Tells(Teller):
        def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
            told(tick)
            return super().observe(observations, belief)

    def sense(belief: Value, tick: Tick) -> Elements:
        told(tick)
        return ()

    def context(belief: Value, *, tick: Tick) -> Elements:
        told(tick)
        return ()

    nodes = {"w": World0("w"), "b": Teller("b"), "a": Tells("a")}
    edges = [Edge("w", "a", sense, None, context), Edge("a", "b")]
    active = ActiveHierarchy.initial(Hierarchy(nodes, "w", edges, OperatorSetting(seed=11)))
    update(update(active))
    assert ticks[:3] == [
        (11, "w->a", "sense", 1, 0.5, ("w",), ("a",)),
        (11, "a", "observe", 1, 0.5, ("w",), ("b",)),
        (11, "w->a", "context", 1, 0.5, ("w",), ("a",)),
    ]
    assert [tick[3:5] for tick in ticks[3:]] == [(2, 1.0)] * 3


def test_the_world_alone_is_a_hierarchy() -> None:
    active = update(ActiveHierarchy.initial(Hierarchy({"w": World0("w")}, "w", [])))
    assert beliefs(active) == {"w": "w[|default(w)]"}


def test_an_update_leaves_the_old_active_hierarchy_as_it_was() -> None:
    before = ActiveHierarchy.initial(pair(sense=once("o")))
    update(before)
    assert beliefs(before) == {"w": "w", "n": "n"}
    assert before.epoch == 0
    with pytest.raises(TypeError):
        before.states["n"] = before.states["w"]  # type: ignore[index]


@pytest.mark.parametrize(
    ("sensing", "prediction", "reason"),
    [
        ("abwt", None, "puts '[ab]' before 'w', which is below it"),
        ("wtab", None, "puts 't' before '[ab]', which is below it"),
        ("wab", None, "must name every node once"),
        ("wabtt", None, "must name every node once"),
        ("wabx", None, "must name every node once"),
        (None, "atbw", "puts 't' before 'a', which is below it"),
        (None, "tawb", "puts 'b' before 'w', which is below it"),
        (None, "tab", "must name every node once"),
    ],
)
def test_an_order_that_does_not_respect_the_edges_is_refused(
    sensing: str | None, prediction: str | None, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        update(ActiveHierarchy.initial(diamond()), sensing, prediction)


def failing(operator: str) -> ActiveHierarchy:
    def fail(*arguments: Any) -> Any:
        raise RuntimeError("out of order")

    node = Teller("n")
    edge = {"sense": None, "task": None, "context": None}
    if operator in edge:
        edge[operator] = fail
    elif operator == "policy default":
        node.policies = lambda: {"default": fail}  # type: ignore[method-assign]
    else:
        setattr(node, operator, fail)
    hierarchy = Hierarchy({"w": World0("w"), "n": node}, "w", [Edge("w", "n", **edge)])
    return ActiveHierarchy.initial(hierarchy)


@pytest.mark.parametrize(
    ("operator", "subject"),
    [
        ("observe", "n"),
        ("predict", "n"),
        ("policy default", "n"),
        ("sense", "w->n"),
        ("task", "w->n"),
        ("context", "w->n"),
    ],
)
def test_an_error_says_which_operator_of_what_in_which_epoch(operator: str, subject: str) -> None:
    with pytest.raises(OperatorError) as raised:
        update(failing(operator))
    what, _, place = str(raised.value).partition(" (")
    assert what == f"{subject}: {operator} in epoch 1: RuntimeError: out of order"
    assert re.fullmatch(r"\S+test_process\.py:\d+, in \w+\)", place)
    assert (raised.value.subject, raised.value.operator, raised.value.epoch) == (subject, operator, 1)


def test_an_error_of_an_initial_belief_is_of_epoch_0() -> None:
    with pytest.raises(
        OperatorError, match=r"^n: initial_belief in epoch 0: RuntimeError: out of order \(\S+\.py:\d+, in \w+\)$"
    ):
        failing("initial_belief")


def test_a_hierarchy_checks_its_graph_its_world_and_its_nodes() -> None:
    nodes = {"w": World0("w"), "n": Teller("n")}
    with pytest.raises(HierarchyError, match="cannot be reached"):
        Hierarchy(nodes, "w", [])
    with pytest.raises(HierarchyError, match=r"^n: the world's class must derive from World, Teller does not$"):
        Hierarchy(nodes, "n", [Edge("n", "w")])
    with pytest.raises(HierarchyError, match=r"^n: the initial policy 'default' is none of its policies"):
        Hierarchy({**nodes, "n": Teller("n", "follow")}, "w", [Edge("w", "n")])
    with pytest.raises(HierarchyError, match=r"^n: of no tasks, select_policy must give the initial policy"):
        Hierarchy({**nodes, "n": Swapped("n", "follow default")}, "w", [Edge("w", "n")])
    with pytest.raises(HierarchyError, match=r"^w->n: context must take \(belief\)"):
        Hierarchy(nodes, "w", [Edge("w", "n", context=lambda: ())])


class Swapped(Teller):
    """Its first policy is not its initial one."""


def test_neighbours_are_in_the_order_of_their_names() -> None:
    hierarchy = diamond()
    assert hierarchy.order == ("w", "a", "b", "t")
    assert hierarchy.above("w") == hierarchy.below("t") == ("a", "b")
    assert hierarchy.below("w") == hierarchy.above("t") == ()
    assert hierarchy.world_node is hierarchy.nodes["w"]
