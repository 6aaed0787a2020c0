"""Builders that go by a plan: the shortest one from the present symbols, by answer set programming (clingo).

The encoding is that of a world of blocks: in each step one clear cube comes onto the table or onto a clear cube, or the
arm looks for a cube of which nothing is known, which is then taken to stand on the table. What the hand holds is put
somewhere first. Of plans that are as short, one is followed that puts the fewest cubes onto others."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.tower.builder import Builder
from hierax.nodes.tower.doing import DOING
from hierax.nodes.tower.goals import Towers
from hierax.nodes.tower.rules import LOOKED_FOR, NO_PLAN, Plan, Step, Wish, is_done
from hierax.nodes.tower.symbols import NOTHING, Symbols
from hierax.nodes.tracking.schema import TABLE
from hierax.runtime import Value

# What a cube is on that the hand holds, one of which nothing is known, and one of which that is not settled just now.
HAND, UNKNOWN, UNSETTLED = -1, -2, -3

Blocks = dict[int, int]
"""Of each cube, what it is on."""

_NAMES = {TABLE: "table", HAND: "hand"}

_RULES = """
time(1..n).  place(C) :- cube(C).  place(table).
at(C, L, 0) :- init(C, L).
:- at(C, L, 0), at(D, L, 0), cube(L), C < D.
stood(C) :- init(C, table).  stood(C) :- init(C, hand).  stood(C) :- init(C, L), stood(L).
:- init(C, _), not stood(C).
{ move(C, L, T) : cube(C), place(L), C != L; look(C, T) : cube(C) } = 1 :- time(T).
moved(C, T) :- move(C, _, T).
at(C, L, T) :- move(C, L, T).
at(C, table, T) :- look(C, T).
at(C, L, T) :- at(C, L, T-1), time(T), not moved(C, T).
known(C, T) :- at(C, _, T).
covered(L, T) :- at(_, L, T), cube(L).
:- move(C, _, T), not known(C, T-1).
:- move(C, _, T), covered(C, T-1).
:- move(C, L, T), at(C, L, T-1).
:- move(_, L, T), cube(L), covered(L, T-1).
:- move(_, L, T), cube(L), not known(L, T-1).
:- at(H, hand, T-1), time(T), not moved(H, T).
:- look(C, T), known(C, T-1).
:- stands(C, L), not at(C, L, n).
:- top(C), covered(C, n).
:- free(S, _), #count { C : free(S, C), at(C, table, n) } != 1.
beside(S, C) :- free(S, C), free(S, L), at(C, L, n).
:- free(S, C), not at(C, table, n), not beside(S, C).
:- free(S, C), at(D, C, n), not free(S, D).
#minimize { n - T@2, T : look(_, T) }.
#minimize { 1@1, C, T : move(C, L, T), cube(L) }.
#show move/3.  #show look/2.
"""


class PlanningBuilder(Builder):
    """What plans. Raises ValueError: its library is not there."""

    def __init__(self, tower: Any, cubes: int = CUBES) -> None:
        super().__init__(tower, cubes)
        _library()

    def decided(self, symbols: Symbols, skill: Mapping[str, Any], belief: Value) -> tuple[Wish, Plan]:
        before = Plan(tuple(belief["plan"]), tuple(belief["expects"]))
        if not self._is_ours(before):
            before = NO_PLAN
        now = blocks_of(symbols, self.cubes)
        if before == NO_PLAN and (symbols.doubts or set(now.values()) == {UNSETTLED}):
            return Wish("look"), NO_PLAN  # it is not settled yet what is where
        plan = None if before == NO_PLAN else self.followed(before, now, skill)
        if plan is not None:
            return _wish_of(plan, "as planned"), plan
        settled = _settled(now)
        steps = planned(self.towers, settled)
        if steps is None:
            return Wish("look"), NO_PLAN  # what is believed contradicts itself
        plan = Plan(steps, tuple(settled.items()))
        return _wish_of(plan, "planned" if before == NO_PLAN else "planned again"), plan

    def _is_ours(self, plan: Plan) -> bool:
        """Whether a plan builds these towers of these cubes: a builder before this one may have made it for others."""
        blocks = dict(plan.expects)
        if blocks.keys() != set(self.cubes):
            return False
        for cube, onto in plan.plan:
            blocks[cube] = _goal_of(onto)
        on = tuple((upper, lower) for upper, lower in blocks.items() if lower in blocks)
        built = NOTHING._replace(on=on, on_table=tuple(cube for cube, lower in blocks.items() if lower == TABLE))
        return all(is_done(tower, built) for tower in self.towers)

    @abstractmethod
    def followed(self, plan: Plan, now: Blocks, skill: Mapping[str, Any]) -> Plan | None:
        """What is left of a plan; None: it does not hold any more."""


class Planner(PlanningBuilder):
    """Builds towers by the shortest plan. It is made again where a cube is neither where it was when a move began nor,
    if it is the one that is moved, where that leads to."""

    def followed(self, plan: Plan, now: Blocks, skill: Mapping[str, Any]) -> Plan | None:
        expected, settled = dict(plan.expects), _settled(now)
        cube, onto = plan.plan[0] if plan.plan else (None, TABLE)
        if any(settled[other] != expected[other] for other in now if other != cube):
            return None
        if cube is None:
            return plan
        is_found = onto == LOOKED_FOR and now[cube] == UNSETTLED and _is_over(plan, skill)
        if now[cube] == _goal_of(onto) or is_found:
            return _one_on(plan)
        return plan if now[cube] in (HAND, UNSETTLED, expected[cube]) else None


class OpenLoop(PlanningBuilder):
    """Makes a plan once, and does not look any more: a move is over when the skills node says so. For comparison."""

    def followed(self, plan: Plan, now: Blocks, skill: Mapping[str, Any]) -> Plan:
        return _one_on(plan) if _is_over(plan, skill) else plan


def _goal_of(onto: int) -> int:
    """What a cube is on after a step."""
    return TABLE if onto == LOOKED_FOR else onto


def _one_on(plan: Plan) -> Plan:
    """What is left of a plan after its first step."""
    (cube, onto), *left = plan.plan
    return Plan(tuple(left), tuple((dict(plan.expects) | {cube: _goal_of(onto)}).items()))


def _is_over(plan: Plan, skill: Mapping[str, Any]) -> bool:
    """Whether the skills node says of the first step that it is over."""
    return skill["status"] != DOING and plan.plan[:1] == ((skill["cube"], skill["onto"]),)


def blocks_of(symbols: Symbols, cubes: Sequence[int]) -> Blocks:
    """What each cube is on."""
    known = dict.fromkeys(symbols.on_table, TABLE) | symbols.below | dict.fromkeys(symbols.unknown, UNKNOWN)
    if symbols.holding is not None:
        known[symbols.holding] = HAND
    return {cube: known.get(cube, UNSETTLED) for cube in cubes}


def _settled(blocks: Blocks) -> Blocks:
    """The same, of what is not settled that it stands on the table."""
    return {cube: TABLE if on == UNSETTLED else on for cube, on in blocks.items()}


def planned(towers: Towers, blocks: Blocks) -> tuple[Step, ...] | None:
    """The shortest plan that builds towers of blocks as they are; what is to be looked for comes as late as it can.
    None: blocks cannot be so, as where two are each on the other."""
    facts = "".join((*_facts_of(blocks), *_goals_of(towers)))
    for length in range(2 * len(blocks) + 1):
        control = _library().Control(["--warn=none", f"-c n={length}"])
        control.add("base", [], _RULES + facts)
        control.ground([("base", [])])
        with control.solve(yield_=True) as found:
            shown = [model.symbols(shown=True) for model in found]
        if shown:
            return tuple(step for _, step in sorted(map(_step_of, shown[-1])))
    return None


def _facts_of(blocks: Blocks) -> Iterator[str]:
    for cube, on in blocks.items():
        yield f"cube({cube})."
        if on != UNKNOWN:
            yield f"init({cube}, {_NAMES.get(on, on)})."


def _goals_of(towers: Towers) -> Iterator[str]:
    for number, tower in enumerate(towers):
        if isinstance(tower, frozenset):
            yield from (f"free({number}, {cube})." for cube in sorted(tower))
            continue
        for lower, upper in pairwise((_NAMES[TABLE], *tower)):
            yield f"stands({upper}, {lower})."
        yield f"top({tower[-1]})."


def _step_of(shown: Any) -> tuple[int, Step]:
    """At which instant which step is taken."""
    cube, *onto, instant = shown.arguments
    if not onto:
        return instant.number, (cube.number, LOOKED_FOR)
    return instant.number, (cube.number, onto[0].number if onto[0].type.name == "Number" else TABLE)


def _wish_of(plan: Plan, rule: str) -> Wish:
    if not plan.plan:
        return Wish("done")
    return Wish(rule, *plan.plan[0])


def _library() -> Any:
    try:
        return import_module("clingo")
    except ImportError as error:
        raise ValueError("a builder that plans needs clingo: pip install 'hierax[plan]'") from error
