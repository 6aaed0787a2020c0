"""Who changed what in a launch, or tried to: lines of JSON in the folder of its log, for its user alone."""

import json
import os
from collections.abc import Callable, Mapping
from typing import Any

from hierax.runtime.watch.logs import AUDIT, LaunchLog, log_of_run
from hierax.schemas.roster import Change, new_nodes
from hierax.schemas.values import Value

LONGEST_CHARS = 4000  # of a change with all its parameters; one that is longer is told without

_BY_CHARS = 200
_NOT_SAID = "somebody who does not say who it is"


class Audit:
    """Writes down a launch's changes, as its requests have them, and who was not let in."""

    def __init__(self, run: str, epoch: Callable[[], int]) -> None:
        self._log: LaunchLog = log_of_run(run, AUDIT, epoch)

    def begun(self, deployment: str, endpoint: str, warning: str) -> None:
        """The launch has begun, as this user."""
        told = f"; {warning}" if warning else ""
        self._write(f"user {os.getuid()} has launched {deployment}, reached at {endpoint}{told}")

    def refused_link(self, what: str) -> None:
        """Somebody has no key or no certificate; `hierax.runtime.watch.refused` says who."""
        self._write(what, outcome="refused")

    def settled(self, change: Change, by: str, answer: Mapping[str, Value]) -> None:
        """A change is in force, with an ``epoch``, or is none, with a ``refusal``."""
        plain = change.plain()
        kind = str(plain["change"])
        names = ", ".join(new_nodes(change)) or str(plain.get("name", ""))
        outcome = f"refused: {answer['refusal']}" if "refusal" in answer else f"at epoch {answer.get('epoch')}"
        fields: dict[str, Any] = {"by": by, "change": kind, "nodes": names, "outcome": outcome}
        if len(json.dumps(plain, default=str)) <= LONGEST_CHARS:
            fields["details"] = plain
        self._write(f"{kind} {names} by {by}: {outcome}", **fields)

    def refused(self, what: str, by: str) -> None:
        """What was asked for is no change that could be read."""
        self._write(f"a change by {by}: refused: {what}", by=by, outcome=f"refused: {what}")

    def close(self, message: str) -> None:
        self._log.close(message)

    def _write(self, message: str, **fields: Any) -> None:
        self._log.write(message, logger="hierax.audit", **fields)


def asker(query: Mapping[str, Any]) -> str:
    """Who asks, as it says of itself, which nobody proves: a user, a machine, a process."""
    by = query.get("by")
    sound = isinstance(by, str) and 0 < len(by) <= _BY_CHARS and by.isprintable()
    return by if sound and isinstance(by, str) else _NOT_SAID
