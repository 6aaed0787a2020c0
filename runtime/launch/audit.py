"""Who changed what in a launch, or tried to: lines of JSON in the folder of its log, for its user alone."""

import json
import os
from collections.abc import Callable, Mapping
from typing import Any

from hierax.runtime.host.run_secret import certificates_of
from hierax.runtime.watch.logs import AUDIT, LaunchLog, log_of_run
from hierax.schemas.roster import Change, new_nodes
from hierax.schemas.values import Value

LONGEST_CHARS = 4000  # of a change with all its parameters; one that is longer is told without

_BY_CHARS = 200
_NOT_SAID = "somebody who does not say who it is"


class Audit:
    """Writes down a launch's changes, as its requests have them, and who was not let in."""

    def __init__(self, run: str, epoch: Callable[[], int], proof: str) -> None:
        self._proof = proof  # what everybody has shown who is let ask for changes
        self._log: LaunchLog = log_of_run(run, AUDIT, epoch)

    def begun(self, deployment: str, endpoint: str, warning: str) -> None:
        """The launch has begun, as this user."""
        told = f"; {warning}" if warning else ""
        self._write(f"user {os.getuid()} has launched {deployment}, reached at {endpoint}{told}")

    def refused_something(self, what: str) -> None:
        """Somebody has no key, or no certificate that lets it; `hierax.runtime.watch.refused` says who."""
        self._write(what, outcome="refused")

    def settled(self, change: Change, by: str, answer: Mapping[str, Value]) -> None:
        """A change is in force, with an ``epoch``, or is none, with a ``refusal``."""
        plain = change.plain()
        kind = str(plain["change"])
        names = ", ".join(new_nodes(change)) or str(plain.get("name", ""))
        outcome = f"refused: {answer['refusal']}" if "refusal" in answer else f"at epoch {answer.get('epoch')}"
        fields: dict[str, Any] = {"by": by, "with": self._proof, "change": kind, "nodes": names, "outcome": outcome}
        if len(json.dumps(plain, default=str)) <= LONGEST_CHARS:
            fields["details"] = plain
        self._write(f"{kind} {names} by {by} with {self._proof}: {outcome}", **fields)

    def refused(self, what: str, by: str) -> None:
        """What was asked for is no change that could be read."""
        told = {"by": by, "with": self._proof, "outcome": f"refused: {what}"}
        self._write(f"a change by {by} with {self._proof}: refused: {what}", **told)

    def close(self, message: str) -> None:
        self._log.close(message)

    def _write(self, message: str, **fields: Any) -> None:
        self._log.write(message, logger="hierax.audit", **fields)


def proof_of(secret: str) -> str:
    """What somebody has shown who is let ask for changes, by the run's secret."""
    if certificates_of(secret):
        return "an operator's certificate"
    return "the key of the run" if secret else "no proof, as the launch is open"


def asker(query: Mapping[str, Any]) -> str:
    """Who asks, as it says of itself, which nobody proves: a user, a machine, a process."""
    by = query.get("by")
    sound = isinstance(by, str) and 0 < len(by) <= _BY_CHARS and by.isprintable()
    return by if sound and isinstance(by, str) else _NOT_SAID
