"""What a launch does about a change that is asked for."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.staleness import BARRIER, Staleness
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.launch.audit import Audit
from hierax.runtime.launch.pending_changes import PendingChanges
from hierax.runtime.launch.requests import CHANGES, Requests
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.schemas.control import Propose
from hierax.schemas.roster import Reference, Replace

FREE = Staleness(None)
heard: list[Propose] = []  # by the owner, of the last change


def asked(terms: dict[str, Any] | None, name: str = "big", staleness: Staleness = BARRIER) -> tuple[Any, list[Any]]:
    """What a launch of a ``world`` and a node ``big`` answers who wants to replace one, and what it did, in order."""
    done: list[Any] = []
    heard.clear()

    async def start(order: str) -> None:
        done.append(order)

    async def is_started() -> None:
        pass

    async def send_to_owner(word: Propose) -> None:
        done.append(word.request)
        heard.append(word)
        fake.changes.answer(word.request, 7, "")

    deployment = SimpleNamespace(
        allowance=SimpleNamespace(check_all=lambda change: None),
        staleness=staleness,
        roster=SimpleNamespace(world="world", rates=None),
    )
    orders = SimpleNamespace(
        deployment=deployment,
        order=lambda name, token, life, request, reference, terms: f"{life} {name} for {request}",
        terms=lambda name: ProcessTerms(on_loss="detach", rejoin_timeout_s=3),
    )
    members = {"world": "0", "big": "1"}
    started = SimpleNamespace(wait=is_started)
    fake = SimpleNamespace(
        orders=orders,
        changes=PendingChanges(),
        members=members,
        started=started,
        start=start,
        send_to_owner=send_to_owner,
        save=lambda: done.append("written down"),
    )
    change = Replace(name, Reference("hierax.runtime.sim.nodes:Mixer", {}))
    query = {"ask": "change", "change": change.plain(), "terms": {} if terms is None else {name: terms}}
    audit = SimpleNamespace(settled=lambda change, by, answer: None)
    requests = Requests(cast(RosterSupervisor, fake), cast(Audit, audit))
    return anyio.run(requests._answer, CHANGES, query), done


def test_its_file_is_found_from_any_folder() -> None:
    deployment = SimpleNamespace(name="toys", path=Path("toys.yaml"))
    orders = SimpleNamespace(deployment=deployment, run_id="aaaa1111", overrides=())
    fake = SimpleNamespace(orders=orders, changes=PendingChanges(), members={}, epoch=1, version=0)
    status = Requests(cast(RosterSupervisor, fake), cast(Audit, None))._status()
    assert status["file"] == str(Path.cwd() / "toys.yaml")


def test_the_owner_hears_of_a_change_before_any_process_comes_for_it() -> None:
    """One that came first would be turned away, and the change would wait for another until it is given up."""
    answer, done = asked({})
    assert answer == {"epoch": 7}
    written, heard, started = done
    assert (written, started) == ("written down", f"newcomer big for {heard}")


def test_what_takes_a_place_without_terms_of_its_own_has_those_that_are_held_there() -> None:
    assert asked(None)[0] == {"epoch": 7}
    assert heard[0].on_loss == {"big": "detach"}
    assert heard[0].rejoin_timeout_s == {"big": 3.0}
    assert heard[0].alone == ("big",)
    asked({})  # terms that say nothing are some
    assert heard[0].on_loss == {"big": "restart"}


def test_a_rate_that_would_mean_nothing_is_refused() -> None:
    """With the barrier only the world begins epochs, and with a bound on staleness nobody waits for a clock."""
    for name, staleness in (("big", BARRIER), ("big", Staleness(2)), ("world", Staleness(2))):
        with pytest.raises(HieraxError, match=f"node '{name}' cannot have a rate of 5 Hz: nodes have rates"):
            asked({"rate_hz": 5}, name, staleness)
    for name, staleness in (("big", FREE), ("world", FREE), ("world", BARRIER)):
        answer, _ = asked({"rate_hz": 5}, name, staleness)
        assert answer == {"epoch": 7}
