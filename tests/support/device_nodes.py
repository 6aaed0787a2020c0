"""A world with an actuator outside, for tests of what survives a crash; and nodes above it."""

from __future__ import annotations

import os
import time
from pathlib import Path

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World

DEVICE = """\
hierarchy: device
world: world
epoch_deadline_s: {deadline_s}
on_uncertain_act: {on_uncertain_act}
restart: {{max_restarts: 0, restart_delay: 0.0}}
modules: ["support.*"]
parameters: {{log: {log}}}
nodes:
  world: {{class: "support.device_nodes:Rover", parameters: {{log: "${{log}}"}}}}
  arm: {{class: "support.device_nodes:Guesser"}}
  eye: {{class: "support.device_nodes:Guesser"{eye}}}
  spatial: {{class: "support.device_nodes:Guesser"}}
edges:
  world -> arm: {{sense: "support.device_nodes:place", context: "support.device_nodes:level"}}
  world -> eye: {{sense: "support.device_nodes:place"}}
  arm -> spatial: {{sense: "support.device_nodes:level", context: "support.device_nodes:level"}}
"""
"""A world, an arm below a spatial node, and an eye that nobody listens to."""


MOVES_S = "HIERAX_DEVICE_MOVES_S"
"""Environment variable: how long a move takes; no parameter, so that the digests don't depend on it."""


HOLDS_UP = "HIERAX_DEVICE_HOLDS_UP"
"""Environment variable: a file; while it is there, guessers don't come up."""

POLL_S = 0.005


class Rover(World):
    """Moves a device, which logs the epochs in which it moved, by whose process; its belief comes from above.

    Args:
        log: of the device.
    """

    def __init__(self, log: str) -> None:
        self._log = log
        self._moves_s = float(os.environ.get(MOVES_S, "0"))

    def initial_belief(self) -> Value:
        return {"place": 0, "level": 0.0}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return {"place": belief["place"] + 1, "level": belief["level"] / 2 + sum(context)}

    def act(self, actions: Elements, tick: Tick = NO_TICK) -> None:
        device = os.open(self._log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.write(device, f"{tick.epoch}\n".encode())
        os.close(device)
        if self._moves_s:
            time.sleep(self._moves_s)


class Guesser(Node):
    """Guesses at a level from what it observes."""

    def __init__(self) -> None:
        while os.path.exists(os.environ.get(HOLDS_UP, "")):
            time.sleep(POLL_S)

    def initial_belief(self) -> Value:
        return 0.0

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        return belief / 2 + sum(observations) + tick.rng.random()

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + sum(context)


def place(belief: Value) -> Elements:
    """φ of the rover."""
    return (belief["place"] + belief["level"],)


def level(belief: Value) -> Elements:
    """φ and ϱ of a guesser."""
    return (belief % 1,)


def acts(log: Path) -> list[int]:
    """The epochs in which a device has moved, in its order."""
    return [int(line) for line in log.read_text().splitlines()] if log.exists() else []
