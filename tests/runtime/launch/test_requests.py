"""What a launch does about a change that is asked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import anyio

from hierax.runtime.launch.pending_changes import PendingChanges
from hierax.runtime.launch.requests import Requests
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.schemas.control import Propose
from hierax.schemas.roster import Reference, Replace


def test_the_owner_hears_of_a_change_before_any_process_comes_for_it() -> None:
    """One that came first would be turned away, and the change would wait for another until it is given up."""
    done: list[Any] = []

    async def start(order: str) -> None:
        done.append(order)

    async def send_to_owner(word: Propose) -> None:
        done.append(word.request)
        fake.changes.answer(word.request, 7, "")

    orders = SimpleNamespace(
        deployment=SimpleNamespace(allowance=SimpleNamespace(check_all=lambda change: None)),
        order=lambda name, token, life, request, reference, terms: f"{life} {name} for {request}",
    )
    fake = SimpleNamespace(
        orders=orders, changes=PendingChanges(), members={"big": "1"}, start=start, send_to_owner=send_to_owner
    )
    requests = Requests(cast(RosterSupervisor, fake))
    change = Replace("big", Reference("hierax.runtime.sim.nodes:Mixer", {}))
    query = {"ask": "change", "change": change.plain(), "terms": {"big": {}}}
    assert anyio.run(requests._answer, query) == {"epoch": 7}
    assert done[1:] == [f"newcomer big for {done[0]}"]
