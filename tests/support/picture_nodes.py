"""Nodes between which large pictures go in both directions, and which look at each of them."""

import os
from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World

KEPT = "PICTURES_KEPT"  # in the environment: how many of the pictures that come a node keeps beside its belief


DEPLOYMENT = """\
hierarchy: pictures
world: world
modules: ["support.*"]
restart: {{max_restarts: 0, restart_delay: 0.0}}
nodes:
  world: {{class: "support.picture_nodes:Scene"}}
  low: {{class: "support.picture_nodes:Viewer"}}
  high: {{class: "support.picture_nodes:Viewer"}}
edges:
  world -> low:
    sense: {{function: "support.picture_nodes:Picture", parameters: {{size: {size}}}}}
    context: {{function: "support.picture_nodes:Picture", parameters: {{size: 20000, asks: false}}}}
  low -> high:
    sense: {{function: "support.picture_nodes:Picture", parameters: {{size: {size}, asks: false}}}}
    context: {{function: "support.picture_nodes:Picture", parameters: {{size: {size}}}}}
"""


def lent_by(pid: int) -> dict[str, int]:
    """The memory that a process lends, or that is lent to it: bytes that it has mapped, by inode."""
    try:
        lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return {}
    mapped = [line.split()[:5] for line in lines if "/memfd:hierax" in line]
    return {inode: int(span.split("-")[1], 16) - int(span.split("-")[0], 16) for span, _, _, _, inode in mapped}


class Scene(World):
    """N₀: the number of the scene."""

    def initial_belief(self) -> Value:
        return {"scene": 0, "seen": 0}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return {"scene": belief["scene"] + 1, "seen": looked_at(context, belief["seen"])}


class Viewer(Node):
    """Keeps what it has made of all pictures so far, and some of them beside its belief, which changes nothing."""

    def __init__(self) -> None:
        self._kept: deque[NDArray[np.uint8]] = deque(maxlen=int(os.environ.get(KEPT, "0")))

    def initial_belief(self) -> Value:
        return {"seen": 0}

    def observe(self, observations: Elements, belief: Value) -> Value:
        self._kept += [element["picture"] for element in observations]
        return {"seen": looked_at(observations, belief["seen"])}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return {"seen": looked_at(context, belief["seen"])}


class Picture:
    """φ and ϱ: a picture of a belief, of so many bytes, in memory that the tick gives, or in memory of its own that is
    filled anew in each epoch."""

    def __init__(self, size: int, asks: bool = True) -> None:
        self._size, self._asks = size, asks
        self._own = np.zeros(size, np.uint8)

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        picture = tick.empty(self._size, np.uint8) if self._asks else self._own
        picture[:] = (7 * tick.epoch + sum(map(int, belief.values()))) % 251
        return ({"picture": picture},)


def looked_at(elements: Elements, seen: int) -> int:
    """What is in a picture, on its first, middle and last pages, and whether that is the same, with what was seen."""
    for element in elements:
        picture = element["picture"]
        some = {int(picture[place]) for place in (0, picture.size // 2, picture.size - 1)}
        seen = (seen * 31 + sum(some) + 1000 * len(some)) % 1_000_003
    return seen
