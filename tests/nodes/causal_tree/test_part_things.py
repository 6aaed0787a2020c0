from __future__ import annotations

import numpy as np

from hierax.nodes.causal_tree.part import INFERRED, MOST_NODES, SEEN, part_things
from hierax.runtime.core.showing import GREY, Graph

STATES = {"rain": ("no", "yes"), "wet": ("no", "yes"), "slip": ("no", "a bit", "yes")}
ARROWS = [("season", "rain"), ("rain", "wet"), ("wet", "slip"), ("rain", "slip")]
POSTERIORS = {"rain": np.array([0.25, 0.75]), "wet": np.array([0.0, 1.0]), "slip": np.array([0.5, 0.3, 0.2])}


def test_each_node_has_its_most_probable_state_and_stands_below_its_causes() -> None:
    things = part_things(ARROWS, STATES, POSTERIORS, {"wet"})
    assert things["posterior/rain/yes"] == 0.75
    assert things["posterior/slip/a bit"] == 0.3
    graph = things["network"]
    assert isinstance(graph, Graph)
    assert graph.nodes == {
        "season": "season",
        "rain": "rain\nyes 0.750",
        "wet": "wet\nyes 1.000",
        "slip": "slip\nno 0.500",
    }
    assert graph.places is not None
    assert graph.colours == {"season": GREY, "rain": INFERRED, "wet": SEEN, "slip": INFERRED}
    heights = [graph.places[name][1] for name in ("season", "rain", "wet", "slip")]
    assert heights == sorted(set(heights))


def test_a_node_alone_is_no_picture() -> None:
    things = part_things(ARROWS[:1], STATES, {"rain": POSTERIORS["rain"]}, ())
    assert things == {"posterior/rain/no": 0.25, "posterior/rain/yes": 0.75}


def test_of_a_large_part_no_picture_is_made() -> None:
    names = [f"n{number}" for number in range(MOST_NODES + 1)]
    things = part_things([], dict.fromkeys(names, ("no", "yes")), dict.fromkeys(names, np.array([0.5, 0.5])), ())
    assert things == {"certainty/mean": 0.5}
