"""Certificates that hold for a while alone: each process gets a new one when a third of that is over, one by one.

A process then opens another session, has its nodes use it, and closes the one before."""

import anyio

from hierax.runtime.launch.child import Child, ProcessState
from hierax.runtime.launch.frames import RENEW
from hierax.runtime.launch.process_supervisor import Notify
from hierax.runtime.launch.roster_supervisor import RosterSupervisor

RENEWS_S = 60.0  # how long a process may take for it, until the next one's turn
LOOK_S = 0.05


async def renew_again_and_again(processes: RosterSupervisor, lifetime_s: float | None, notify: Notify) -> None:
    """Until it is cancelled; None: they hold as long as the run."""
    if lifetime_s is None:
        return
    due_s = anyio.current_time()
    while True:
        due_s = max(due_s + lifetime_s / 3, anyio.current_time())
        await anyio.sleep_until(due_s)
        for child in [each for each in processes.children if _stands_for_its_process(each)]:
            if not await _is_renewed(child):
                notify(f"{child.name}: its process has not got another certificate within {RENEWS_S:g} s")


def _stands_for_its_process(child: Child) -> bool:
    """Whether it is up, and the first such where nodes share a process."""
    return child is next((each for each in child.mates or [child] if each.state is ProcessState.UP), None)


async def _is_renewed(child: Child) -> bool:
    """Whether a process shows another certificate from now on; or has ended, as the next one gets one anyway."""
    before = child.renewals
    await child.send({RENEW: child.renewed_secret()})
    with anyio.move_on_after(RENEWS_S):
        while child.renewals == before and child.state is ProcessState.UP:
            await anyio.sleep(LOOK_S)
    return child.renewals > before or child.state is not ProcessState.UP
