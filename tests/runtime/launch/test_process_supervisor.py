"""What the keeper knows of processes that are kept elsewhere."""

from __future__ import annotations

from typing import Any, cast

import anyio

from hierax.runtime.launch.frames import BEAT
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.process_supervisor import ProcessSupervisor
from hierax.schemas.control import Control, Lost


class Deployment:
    """With a world."""

    name = "toys"

    class roster:  # noqa: N801 - as an attribute
        world = "world"


class FewOrders:
    """Of that deployment."""

    run_id = "0"
    deployment = Deployment


def keeper() -> ProcessSupervisor:
    """One without processes of its own."""

    def fail(why: Exception) -> None:
        raise why

    return ProcessSupervisor(cast(Orders, FewOrders()), lambda what: None, fail)


def beat(processes: dict[str, str], nodes: tuple[str, ...]) -> dict[str, Any]:
    """What the world's process says."""
    numbers = dict.fromkeys(nodes, 0)
    return {"status": BEAT, "epoch": 1, "version": 1, "instances": numbers, "processes": processes}


def test_a_lost_node_that_is_kept_elsewhere_is_still_known_when_the_world_is_new() -> None:
    async def main() -> None:
        keeping = keeper()
        keeping._take_from_world(beat({"world": "w", "top": "t"}, ("world", "top")))
        keeping._take_from_world(beat({"world": "w2"}, ("world", "top")))
        assert keeping.members == {"world": "w2", "top": "t"}
        keeping._take_from_world(beat({"world": "w2"}, ("world",)))
        assert keeping.members == {"world": "w2"}, "it was detached"

    anyio.run(main)


def test_a_process_that_goes_before_its_place_is_known_here_is_told_of() -> None:
    told: list[Control] = []

    async def main() -> None:
        keeping = keeper()
        keeping.hears_of = lambda token: False

        async def tell(word: Control) -> None:
            told.append(word)

        async def hear() -> None:
            keeping._take_from_world(beat({"world": "w", "top": "t"}, ("world", "top")))

        keeping.tell_owner = tell  # type: ignore[method-assign]
        keeping.hear_members = hear  # type: ignore[method-assign]
        keeping._take_from_world(beat({"world": "w"}, ("world",)))
        await keeping.on_gone("top", "t")

    anyio.run(main)
    assert told == [Lost("top", "t", True)]
