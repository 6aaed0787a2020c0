"""What a part of a causal tree shows: `hierax view`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hierax.nodes.causal_tree.extended_floats import Floats
from hierax.runtime.core.graph import topological_order
from hierax.runtime.core.showing import GREY, Colour, Graph, Things, colour_of

FEW_NODES = 4  # of a smaller part all posteriors are curves
MOST_NODES = 60  # a larger part is no picture that anybody can read
SEEN, INFERRED = colour_of(6), colour_of(2)  # colours of nodes of which there is evidence, and of the others
_ACROSS, _DOWN = 130.0, 90.0


def part_things(
    arrows: Sequence[tuple[str, str]],
    states: Mapping[str, Sequence[str]],
    posteriors: Mapping[str, Floats],
    seen: Collection[str],
) -> Things:
    """The part's network, each node with its most probable state; the posteriors, or how sure the part is on average.

    Args:
        arrows: from parents, which may be in other parts, to the part's nodes.
        states: by node of the part, its states' names.
        posteriors: by node, P(state | evidence); all 0 where the evidence contradicts itself.
        seen: the nodes of which there is evidence.
    """
    if len(posteriors) <= FEW_NODES:
        rows = {name: zip(states[name], row, strict=True) for name, row in posteriors.items()}
        things = {f"posterior/{name}/{state}": float(p) for name, row in rows.items() for state, p in row}
    else:
        things = {"certainty/mean": float(np.mean([row.max() for row in posteriors.values()]))}
    if not 1 < len(posteriors) <= MOST_NODES:
        return things
    texts = {name: f"{name}\n{states[name][int(row.argmax())]} {row.max():.3f}" for name, row in posteriors.items()}
    guests = {parent: parent for parent, _ in arrows if parent not in texts}
    colours: dict[str, Colour] = {name: SEEN if name in seen else INFERRED for name in texts}
    colours.update(dict.fromkeys(guests, GREY))
    nodes = {**guests, **texts}
    return {**things, "network": Graph(nodes, arrows, _places(tuple(nodes), arrows), colours)}


def _places(names: Sequence[str], arrows: Sequence[tuple[str, str]]) -> dict[str, tuple[float, float]]:
    """Causes above what they cause, in rows."""
    depths = dict.fromkeys(names, 0)
    for child in topological_order(names, arrows):
        depths[child] = max((depths[parent] + 1 for parent, other in arrows if other == child), default=0)
    rows: dict[int, list[str]] = {}
    for name in names:
        rows.setdefault(depths[name], []).append(name)
    return {
        name: ((at - (len(row) - 1) / 2) * _ACROSS, depth * _DOWN)
        for depth, row in rows.items()
        for at, name in enumerate(row)
    }
