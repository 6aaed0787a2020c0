"""Certificates that hold for a while alone: each process gets a new one when a third of that is over, one by one.

A process then opens another session, has its nodes use it, and closes the one before."""

from collections.abc import Callable, Iterable

import anyio

from hierax.runtime.launch.child import Child
from hierax.runtime.launch.process_supervisor import Notify, ProcessSupervisor
from hierax.runtime.launch.recorder_process import RecorderChild

PARTS = 3  # of the time that certificates hold; when the first one is over, new ones come
RENEWS_S = 60.0  # how long a process may take for it, until the next one's turn
LOOK_S = 0.05


Shown = Child | RecorderChild
"""A process that shows certificates."""


async def renew_again_and_again(due: Callable[[], Iterable[Shown]], lifetime_s: float | None, notify: Notify) -> None:
    """Whatever is up then, until it is cancelled; None: certificates hold as long as the run."""
    if lifetime_s is None:
        return
    due_s = anyio.current_time()
    while True:
        due_s = max(due_s + lifetime_s / PARTS, anyio.current_time())
        await anyio.sleep_until(due_s)
        for each in due():
            if each.is_up:  # it may have ended while others had their turn
                await renew(each, each.renewed_secret(), notify)


async def renew(shown: Shown, secret: str, notify: Notify) -> None:
    """Have a process show another certificate, unless it ends before, as the next one gets one anyway; where it does
    not come to that, people are told."""
    before = shown.renewals
    await shown.renew(secret)
    with anyio.move_on_after(RENEWS_S):
        while shown.renewals == before and shown.is_up:
            await anyio.sleep(LOOK_S)
    if shown.renewals == before and shown.is_up:
        notify(f"{shown.name}: its process has not got another certificate within {RENEWS_S:g} s")


def one_of_each(processes: ProcessSupervisor) -> list[Shown]:
    """The processes of nodes that are up; of nodes that share one, the first such stands for it."""
    return [
        child
        for child in processes.children
        if child is next((each for each in child.mates or [child] if each.is_up), None)
    ]
