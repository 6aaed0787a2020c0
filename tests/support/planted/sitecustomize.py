"""Imported by every Python process of a launch with faults, before anything else; plants them where a node is run."""

from __future__ import annotations

import sys
from typing import Any

if "hierax.runtime.launch.forking" in sys.orig_argv:
    from support.faults import plant_next

    from hierax.runtime.launch import node_worker

    made_member, made_world = node_worker.Member, node_worker.WorldMember

    def member(*arguments: Any, **options: Any) -> Any:
        """A node's member of the run, with its fault."""
        made = made_member(*arguments, **options)
        plant_next(made, None)
        return made

    def world_member(*arguments: Any, **options: Any) -> Any:
        """The same of the world."""
        made = made_world(*arguments, **options)
        plant_next(made.member, made)
        return made

    node_worker.Member, node_worker.WorldMember = member, world_member  # type: ignore[assignment,misc]
