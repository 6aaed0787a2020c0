"""The runtime: what turns nodes and a deployment file into a running hierarchy."""

from hierax.runtime.core.node import Elements, Node, Value, World
from hierax.runtime.core.probe import Probe, Step
from hierax.runtime.core.tick import NO_TICK, Tick

__all__ = ["NO_TICK", "Elements", "Node", "Probe", "Step", "Tick", "Value", "World"]
