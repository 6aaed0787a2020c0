"""Asks the system to run a node's thread before others, after all others, or on processors of its own."""

import logging
import os
from collections.abc import Sequence

_log = logging.getLogger("hierax")

REAL_TIME = {"fifo": os.SCHED_FIFO, "rr": os.SCHED_RR}
POLICIES = ("other", *REAL_TIME, "idle")


def ask_scheduler(name: str, policy: str, priority: int, cpus: Sequence[int] | None) -> None:
    """Have the calling thread scheduled so; where the system does not allow it, a warning says how it would.

    Threads and processes that it starts later are scheduled as all else where it goes before that, and as itself where
    it gives way: what computes for it may be theirs."""
    if cpus is not None:
        try:
            os.sched_setaffinity(0, cpus)
        except OSError as error:
            there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
            _log.warning("%s: processors %s: %s; it may run on %s", name, list(cpus), error.strerror, there)
    if policy == "idle":  # for which nobody needs a permission
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    if policy not in REAL_TIME:
        return
    try:
        os.sched_setscheduler(0, REAL_TIME[policy] | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        _log.warning(
            "%s: no real-time scheduling (%s, priority %d): %s; root allows it by a line '%s - rtprio %d' in "
            "/etc/security/limits.conf, from the next login on, and in a container by --cap-add=sys_nice",
            name,
            policy,
            priority,
            error.strerror,
            _user(),
            priority,
        )


def _user() -> str:
    return os.environ.get("USER") or str(os.getuid())
