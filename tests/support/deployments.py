"""Deployment files for tests."""

from __future__ import annotations

from pathlib import Path

TOYS = """\
hierarchy: toys
description: a counter and two that sum
epochs: 3
world: world
parameters:
  step: 2
  scale: 0.5
  context: true
nodes:
  world:
    class: support.toy_nodes:Counter
    parameters: {step: "${step}"}
  left: {class: support.toy_nodes:Summer}
  top.most:
    class: support.toy_nodes:Summer
    parameters:
      scale: "${scale}"
      weights: [1, 2.5]
edges:
  world -> left:
    sense: support.toy_nodes:seen
  world->top.most:
    sense: {function: "support.toy_nodes:seen", parameters: {offset: 1}}
  left -> top.most:
    sense: support.toy_nodes:seen
    task: null
    context:
      function: support.toy_nodes:Scale
      parameters: {factor: 2}
      enabled: "${context}"
probes:
  - node: left
    class: support.toy_nodes:Keeper
    parameters: {file: "${step}.csv"}
"""
"""A right one, with everything in it that a deployment may have, but Zenoh's settings."""


def write(folder: Path, text: str = TOYS, name: str = "toys.yaml") -> Path:
    """A deployment file with this text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def replaced(old: str, new: str, text: str = TOYS) -> str:
    """The text with one part, which must be there, replaced."""
    assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times"
    return text.replace(old, new)


def line_of(part: str, text: str = TOYS) -> int:
    """The line in which a part begins, counted from 1."""
    return text.count("\n", 0, text.index(part)) + 1
