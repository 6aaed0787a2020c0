"""Shipped deployments at a measured pace, so that what runs beside a test leaves the processor to it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import yaml

from hierax.runtime import Probe
from hierax.runtime.core.probe import Step
from hierax.runtime.deployment.deployment import shipped

PACE_S = 0.01


class Pace(Probe):
    """Has the node that it watches wait in each epoch."""

    def record(self, step: Step) -> None:
        time.sleep(PACE_S)


def paced(folder: Path, name: str, **fields: Any) -> str:
    """The path of a shipped deployment with a world that waits in each epoch, and with these fields."""
    plain = yaml.safe_load(shipped()[name].read_text(encoding="utf-8"))
    probes = [*plain.get("probes", ()), {"node": plain["world"], "class": "support.pace:Pace"}]
    path = folder / f"paced-{name}.yaml"
    path.write_text(yaml.safe_dump({**plain, "probes": probes, **fields}, sort_keys=False), encoding="utf-8")
    return str(path)
