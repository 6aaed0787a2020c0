"""``hierax health``: whether a launch goes on, for what starts it and looks after it."""

import time
from typing import TYPE_CHECKING, Annotated, Any

from hierax.runtime.commands.options import Format, RunOptions, offers, option
from hierax.runtime.commands.show import print_json
from hierax.runtime.commands.which_launch import client_at, launch_meant

if TYPE_CHECKING:
    from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus

LOOK_S = 0.1
ANSWER_S = 5.0  # how long each answer may take: a launch that is stopped gives none
_WELL = ("running", "elsewhere")  # states of a process that nobody has to wait for


@offers("run", "connect", "key", "output_format")
def health(options: RunOptions, within: Annotated[float, option("--within", min=0.0)] = 10.0) -> int:
    """See whether a launch goes on: it commits an epoch in time. Exit code 1 where it does not."""
    with client_at(launch_meant(options.run, options.connect, options.key)) as client:
        first, last = _watched(client, within)
    goes_on = within == 0.0 or last.epoch > first.epoch
    missed = {name: node["state"] for name, node in last.nodes.items() if node["state"] not in _WELL}
    told = f"{last.hierarchy}, run {last.run}: epoch {last.epoch}"
    if not goes_on:
        told += f", none after it within {within:g} s"
    told += "".join(f"; {name} is {state}" for name, state in sorted(missed.items()))
    if options.output_format is Format.json:
        print_json(_plain(last, goes_on, missed))
    else:
        print(told)
    return 0 if goes_on else 1


def _watched(client: "LaunchClient", within_s: float) -> tuple["LaunchStatus", "LaunchStatus"]:
    """How a launch does, and how it does when it has committed another epoch, or has had the time for it."""
    until_s = time.monotonic() + within_s
    first = last = client.status(ANSWER_S)
    while last.epoch <= first.epoch and time.monotonic() < until_s:
        time.sleep(min(LOOK_S, max(until_s - time.monotonic(), 0.0)))
        last = client.status(ANSWER_S)
    return first, last


def _plain(status: "LaunchStatus", goes_on: bool, missed: dict[str, Any]) -> dict[str, Any]:
    return {
        "goes_on": goes_on,
        "hierarchy": status.hierarchy,
        "run": status.run,
        "epoch": status.epoch,
        "missed": missed,
    }
