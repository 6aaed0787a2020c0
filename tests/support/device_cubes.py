"""The tracking deployment's simulated world with an actuator outside."""

from __future__ import annotations

import os
from typing import Any

from hierax.nodes.tracking.simworld.world import SimWorld
from hierax.runtime import NO_TICK, Elements, Tick

LOG = "HIERAX_DEVICE_LOG"
"""Environment variable: the log of the device; no parameter, so that the digests don't depend on it."""


class Actuated(SimWorld):
    """Moves a device as well, which logs the epochs in which it moved.

    Args:
        cubes, frames, noise, blur_px: of `SimWorld`.
        others: what else the deployment gives to the function that makes its world; all at their defaults.
    """

    def __init__(self, cubes: int, frames: int, noise: float, blur_px: float, **others: Any) -> None:
        super().__init__(cubes=cubes, frames=frames, noise=noise, blur_px=blur_px)

    def act(self, actions: Elements, tick: Tick = NO_TICK) -> None:
        device = os.open(os.environ[LOG], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.write(device, f"{tick.epoch}\n".encode())
        os.close(device)
