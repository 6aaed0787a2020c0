"""What the nodes of a tower deployment show besides what tracking and picking show: `hierax view`.

The views: ``builder/towers``, the symbols as a graph, each cube above what it is on; ``builder/why``, the rule or the
plan that is followed, and the symbols with their certainty, in words; ``builder/certainty``, the same as curves; and
``skills/skill``, what the hand does. In ``scene`` the gripper, the grasp that it goes for, and the place for a cube."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from hierax.nodes.picking.commands import REST
from hierax.nodes.picking.display import gripper_lines
from hierax.nodes.tower.doing import DOING, doing
from hierax.nodes.tower.goals import Tower, Towers
from hierax.nodes.tower.rules import height_of, order_of
from hierax.nodes.tower.symbols import Symbols
from hierax.nodes.tower.tasks import is_look
from hierax.nodes.tracking.math.geometry import Floats
from hierax.runtime import Value
from hierax.runtime.core import showing

_HAND, _TABLE, _NOWHERE = "hand", "table", "unknown"
_ACROSS, _UP = 90.0, 70.0  # how far cubes are apart in the graph, in the viewer's points
_GROUND: showing.Colour = (170, 170, 170)
_GRIPPER, _GRASP, _PLACE = (230, 230, 230), (250, 170, 40), (40, 200, 80)
_THIN_M = 0.0015


def builder_things(belief: Value, towers: Towers, cubes: Sequence[int]) -> dict[str, showing.Thing]:
    """What a builder believes, and what it wishes for by that; towers: that are asked for; cubes: all there are."""
    symbols = Symbols(**belief["symbols"])
    curves = {
        f"certainty/{symbol}": showing.Curve(chance, showing.colour_of(int(symbol.split()[1])))
        for symbol, chance in symbols.certainty.items()
        if not symbol.startswith("clear")  # no more than what is on others
    }
    return {"towers": _graph(symbols, cubes), "why": _why(belief, symbols, towers, cubes), **curves}


def skill_things(belief: Value, time_s: float) -> dict[str, showing.Thing]:
    """What the hand does, in words; the gripper, where it will close, and where it will open."""
    things: dict[str, showing.Thing] = {"skill": _skill(belief, time_s)}
    if belief["hand"] is None:
        return things
    things["/scene/gripper"] = _gripper(belief["hand"]["gripper"], belief["hand"]["width"], _GRIPPER)
    for name, pose, colour in (("grasp", belief["gripper"], _GRASP), ("place", belief["place"], _PLACE)):
        if pose is not None:
            things[f"/scene/{name}"] = _gripper(pose, belief["box_width"], colour)
    return things


def _graph(symbols: Symbols, cubes: Sequence[int]) -> showing.Graph:
    """Cubes above what they are on, one pile beside the other; at the table's end those of which less is known."""
    below = symbols.below
    piles = [(cube, *symbols.above(cube)) for cube in cubes if cube not in below and cube != symbols.holding]
    places: dict[str, tuple[float, float]] = {}
    edges: list[tuple[str, str]] = []
    for column, pile in enumerate(piles):
        edges.append((str(pile[0]), _NOWHERE if pile[0] in symbols.unknown else _TABLE))
        edges += [(str(upper), str(lower)) for lower, upper in pairwise(pile)]
        places |= {str(cube): (column * _ACROSS, -(level + 1) * _UP) for level, cube in enumerate(pile)}
    settled = {str(cube) for cube in symbols.on_table}
    edges = [(upper, lower) for upper, lower in edges if lower != _TABLE or upper in settled]
    if symbols.holding is not None:
        edges.append((str(symbols.holding), _HAND))
        places[str(symbols.holding)] = (len(piles) * _ACROSS, -2.0 * _UP)
    places[_TABLE] = (max(len(piles) - 1, 0) * _ACROSS / 2, 0.0)
    places |= {_HAND: (len(piles) * _ACROSS, -3.0 * _UP), _NOWHERE: (len(piles) * _ACROSS, 0.0)}
    drawn = {_TABLE, *(name for edge in edges for name in edge), *map(str, cubes)}
    names = [name for name in places if name in drawn]
    texts = {name: _text(name, edges, symbols) for name in names}
    colours = {name: showing.colour_of(int(name)) if name.isdigit() else _GROUND for name in names}
    return showing.Graph(texts, edges, {name: places[name] for name in names}, colours)


def _text(name: str, edges: Sequence[tuple[str, str]], symbols: Symbols) -> str:
    """A graph node's text: a cube, and how certain it is that it is on what it is on."""
    lower = next((lower for upper, lower in edges if upper == name), "")
    chance = symbols.certainty.get(f"on_table {name}" if lower == _TABLE else f"on {name} {lower}")
    return name if chance is None else f"{name}\n{chance:.2f}"


def _why(belief: Value, symbols: Symbols, towers: Towers, cubes: Sequence[int]) -> str:
    """The wish, the plan, and the symbols, as Markdown."""
    wish = "" if belief["cube"] is None else f": {_move(belief['cube'], belief['onto'])}"
    lines = [f"**{belief['rule']}**{wish}"]
    if belief["plan"]:
        lines.append("plan: " + ", ".join(_move(*step) for step in belief["plan"]))
    lines += [_progress(tower, symbols) for tower in towers]
    lines += ["| symbol | holds | probability |\n| --- | --- | --- |\n" + "\n".join(_rows(symbols, cubes))]
    return "\n\n".join(lines)


def _rows(symbols: Symbols, cubes: Sequence[int]) -> list[str]:
    """A row for each symbol that holds, or might."""
    known = {f"on {upper} {lower}" for upper, lower in symbols.on} | {f"on_table {cube}" for cube in symbols.on_table}
    known |= {f"clear {cube}" for cube in cubes if cube not in symbols.unknown and symbols.is_clear(cube)}
    known |= {f"unknown {cube}" for cube in symbols.unknown}
    known |= set() if symbols.holding is None else {f"holding {symbols.holding}"}
    return [
        f"| {name} | {'yes' if name in known else 'no'} | {_chance(name, symbols)} |"
        for name in sorted(known | symbols.certainty.keys(), key=lambda name: (name.startswith("clear"), name))
    ]


def _chance(name: str, symbols: Symbols) -> str:
    return f"{symbols.certainty[name]:.3f}" if name in symbols.certainty else "below 0.01"


def _progress(tower: Tower, symbols: Symbols) -> str:
    order = order_of(tower, symbols)
    return f"tower {' '.join(map(str, order))}: {height_of(order, symbols)} of {len(order)} stand"


def _move(cube: int, onto: int) -> str:
    """A move, or a look for a cube, in words."""
    if is_look((cube, onto)):
        return f"look for {cube}"
    return f"{cube} onto {onto or 'the table'}"


def _skill(belief: Value, time_s: float) -> str:
    goal, asked, now = belief["goal"], belief["asked"], doing(belief)
    what = "nothing to do" if now["skill"] == REST else f"{now['skill']} {now['cube'] or ''}".strip()
    how = "" if now["status"] == DOING else f", {now['status']}"
    lines = [f"**{what}**{how}", f"{belief['phase']} for {time_s - belief['since_s']:.1f} s"]
    lines += [] if goal is None else [f"for: {_move(*goal)}"]
    if asked != goal:
        lines.append("asked for: " + ("nothing" if asked is None else _move(*asked)))
    if belief["refused"] is not None:
        given_up = belief["refused"][0] == belief["target"]
        lines.append(f"{'given up' if given_up else 'to make room for'}: {_move(*belief['refused'])}")
    if belief["hand"] is not None:
        lines.append(f"{1000.0 * belief['hand']['width']:.0f} mm between the fingers")
    return "\n\n".join((*lines, f"moves begun: {belief['moves']}"))


def _gripper(pose: Floats, width_m: Any, colour: showing.Colour) -> showing.Lines3D:
    return showing.Lines3D(gripper_lines(pose, width_m), colour, _THIN_M)
