"""Nodes whose beliefs say all that they have ever observed and been told, in a hierarchy with rates and delays."""

from __future__ import annotations

import time
from hashlib import sha256
from pathlib import Path

import anyio
import numpy as np

from hierax.runtime import Elements, Node, Tick, Value, World

MIXING = """
hierarchy: mixing
world: world
nodes:
  world: {class: "support.mixing_nodes:MixingWorld"}
  quick: {class: "support.mixing_nodes:Mixing"}
  middle: {class: "support.mixing_nodes:Mixing", every: 3, offset: 1}
  slow: {class: "support.mixing_nodes:Mixing", every: 20, offset: 7}
  side: {class: "support.mixing_nodes:Mixing"}
edges:
  world -> quick: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told"}
  world -> slow: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: 20, gather: true}
  quick -> middle: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", gather: true}
  middle -> slow: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: 5}
  quick -> side: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: 1}
"""


ALONE = """
hierarchy: alone
world: world
nodes:
  world: {class: "support.mixing_nodes:MixingWorld", parameters: {takes_s: 0.01}}
  slow: {class: "support.mixing_nodes:Mixing", every: 1000}
edges:
  world -> slow: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: 3000}
"""
"""The world waits for nobody."""

BESIDE = """
nodes:
  beside: {class: "support.mixing_nodes:Mixing", every: 3}
edges:
  world -> beside: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: 40, gather: true}
"""
"""What may be attached to it."""


def written(folder: Path) -> Path:
    """The hierarchy as a file, in a folder."""
    path = folder / "mixing.yaml"
    path.write_text(MIXING)
    return path


def _mixed(*parts: Value) -> int:
    return int.from_bytes(sha256(repr(parts).encode()).digest()[:6], "big")


class MixingWorld(World):
    """Knows only what it was told, and the time; it may take its time."""

    def __init__(self, last: int | None = None, takes_s: float = 0.0) -> None:
        self.last = last  # after which epoch it has finished
        self.takes_s = takes_s

    def initial_belief(self) -> Value:
        return (0, 0)

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick) -> Value:
        if self.takes_s:
            time.sleep(self.takes_s)
        return (tick.epoch, _mixed(context, actions, belief))

    def finished(self, belief: Value) -> bool:
        return bool(belief[0] == self.last)


class Mixing(Node):
    """Knows what it has observed, too; it may take its time."""

    def __init__(self, takes_s: float = 0.0) -> None:
        self.takes_s = takes_s

    def initial_belief(self) -> Value:
        return 1

    def observe(self, observations: Elements, belief: Value) -> Value:
        if self.takes_s:
            time.sleep(self.takes_s)
        return _mixed(observations, belief)

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick) -> Value:
        return _mixed(tick.epoch, tick.rng.random(), context, actions, belief)


class Asking(Mixing):
    """Waits for somebody else, as an `async def` does."""

    async def observe(self, observations: Elements, belief: Value) -> Value:  # type: ignore[override]
        await anyio.sleep(self.takes_s)
        return _mixed(observations, belief)


class Computing(Mixing):
    """Computes for as long."""

    def observe(self, observations: Elements, belief: Value) -> Value:
        begun_s, matrix = time.monotonic(), np.eye(200)
        while time.monotonic() - begun_s < self.takes_s:
            matrix = matrix @ matrix
        return _mixed(observations, belief)


def told(belief: Value) -> Elements:
    """What goes up, or comes down."""
    return (belief,)
