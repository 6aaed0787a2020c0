"""What may be asked of the skills node: one skill with its arguments, as data, and by the name of a policy.

A task is {"skill": `PLACE`, "cube": id, "onto": id, or `TABLE`}, which takes the cube first if the hand does not hold
it, or {"skill": `LOOK`, "cube": id}. On the way down it becomes the name of a policy."""

from typing import Any, TypeGuard

from hierax.nodes.picking.commands import REST
from hierax.nodes.tower.rules import LOOKED_FOR, Step
from hierax.nodes.tracking.schema import TABLE
from hierax.runtime import Elements

PLACE, LOOK = "place", "look"


def task_of(cube: int, onto: int) -> dict[str, Any]:
    """The task by which a wish is carried out."""
    return {"skill": LOOK, "cube": cube} if onto == LOOKED_FOR else {"skill": PLACE, "cube": cube, "onto": onto}


def name_of(tasks: Elements) -> str:
    """The name of the policy that does what is asked for: ``place 3 on 1``, ``place 3 on table``, ``look for 3``.

    Raises ValueError: it is no task as above."""
    if not tasks:
        return REST
    match tasks[0]:
        case {"skill": "look", "cube": int(cube)}:
            return f"{LOOK} for {cube}"
        case {"skill": "place", "cube": int(cube), "onto": int(onto)} if onto >= TABLE:
            return f"{PLACE} {cube} on {onto or 'table'}"
    expected = f'{{"skill": "{PLACE}", "cube": id, "onto": id or {TABLE}}}, or {{"skill": "{LOOK}", "cube": id}}'
    raise ValueError(f"a task of the skills node is {tasks[0]!r:.80}; expected {expected}")


def goal_of(name: str) -> Step:
    """What the policy of a name is to bring about. Raises ValueError: there is none of that name."""
    match name.split(" "):
        case ["look", "for", cube]:
            return int(cube), LOOKED_FOR
        case ["place", cube, "on", "table"]:
            return int(cube), TABLE
        case ["place", cube, "on", onto] if int(onto) > TABLE:
            return int(cube), int(onto)
    raise ValueError(f"no policy has the name {name!r}")


def is_look(goal: Step | None) -> TypeGuard[Step]:
    """Whether what is to be brought about is that a cube is seen."""
    return goal is not None and goal[1] == LOOKED_FOR


def is_move(goal: Step | None) -> TypeGuard[Step]:
    """Whether it is that a cube comes somewhere."""
    return goal is not None and goal[1] != LOOKED_FOR
