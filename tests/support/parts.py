"""Networks as hierarchies in the formal process model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hierax.nodes.causal_tree import Part, as_deployment
from hierax.runtime import Probe, Step
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading.loader import build_hierarchy


def write_deployment(
    folder: Path,
    network: Any,
    sets: Sequence[Mapping[str, Any]],
    parts: Mapping[str, Sequence[str]] | None = None,
    **fields: Any,
) -> Path:
    """A deployment file of a network."""
    path = folder / "network.yaml"
    content = {**as_deployment(network, sets, parts), **fields}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def active(path: Path) -> ActiveHierarchy:
    """A deployment, before its first epoch."""
    deployment = read_deployment(path)
    return ActiveHierarchy.initial(build_hierarchy(deployment.roster, OperatorSetting(), deployment.allowance))


def advanced(hierarchy: ActiveHierarchy, epochs: int) -> ActiveHierarchy:
    """After some Updates."""
    for _ in range(epochs):
        hierarchy = update(hierarchy)
    return hierarchy


def believed(hierarchy: ActiveHierarchy) -> dict[str, np.ndarray]:
    """All posteriors, by node of the network."""
    found: dict[str, np.ndarray] = {}
    for name, state in hierarchy.states.items():
        node = hierarchy.hierarchy.nodes[name]
        if isinstance(node, Part):
            found.update(node.posteriors(state.belief))
    return found


def largest_error(found: Mapping[str, Any], exact: Mapping[str, Any]) -> float:
    """Of all posteriors."""
    assert found.keys() == exact.keys()
    return max(abs(float(a - b)) for name in exact for a, b in zip(found[name], exact[name], strict=True))


KEPT: dict[str, dict[int, Any]] = {}
"""What `Keep` has seen: beliefs by node and epoch."""


class Keep(Probe):
    """Keeps a node's beliefs, in the process of the test."""

    def __init__(self, node: str) -> None:
        self._node = node

    def open(self, output: Path | None) -> None:
        """Of this run only."""
        KEPT[self._node] = {}

    def record(self, step: Step) -> None:
        """Keep it."""
        KEPT[self._node][step.epoch] = step.belief
