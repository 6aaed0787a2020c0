"""``--at EPOCH:CHANGE``: changes of the roster at epochs that are known before the run."""

from __future__ import annotations

from collections.abc import Sequence

from hierax.runtime.allowance import NotAllowedError
from hierax.runtime.deployment.deployment import Deployment
from hierax.runtime.deployment.errors import DeploymentError
from hierax.runtime.deployment.snippet import read_attach, read_replace
from hierax.runtime.nearest import did_you_mean
from hierax.runtime.owner.changes import ChangeError, apply
from hierax.schemas.changes import Change, Detach
from hierax.schemas.roster import Roster

FORMS = {
    "attach": "EPOCH:attach:FILE",
    "detach": "EPOCH:detach:NAME[:cascade]",
    "replace": "EPOCH:replace:NAME:FILE",
}
"""How each change is written."""

_DIGITS = 19


def read_schedule(texts: Sequence[str], deployment: Deployment) -> tuple[tuple[int, Change], ...]:
    """Changes by the epoch that each takes effect at the start of.

    They are tried on the deployment's roster, so that none is refused in the middle of a run.

    Args:
        texts: as ``--at`` has them, see `FORMS`. ``FILE`` is a snippet, or in an attach the
            name of a node of the deployment file.
        deployment: what will be run.

    Returns:
        Sorted by epoch; those of one epoch as they were given, to be made in this order.

    Raises:
        DeploymentError: one is written wrongly, its snippet is wrong, or it cannot be made.
    """
    read = [(*_read(text, deployment), text) for text in texts]
    read.sort(key=lambda entry: entry[0])
    roster = deployment.roster
    for _, change, text in read:
        roster = _after(change, roster, deployment, f"--at {text}")
    return tuple((epoch, change) for epoch, change, _ in read)


def _after(change: Change, roster: Roster, deployment: Deployment, place: str) -> Roster:
    version = roster.version + 1
    try:
        deployment.allowance.check_all(change)
        return apply(roster, change, version, lambda _: version)
    except (ChangeError, NotAllowedError) as error:
        raise DeploymentError(str(error), place) from error


def _read(text: str, deployment: Deployment) -> tuple[int, Change]:
    place = f"--at {text}"
    number, _, rest = text.partition(":")
    kind, _, rest = rest.partition(":")
    kind = kind.strip()
    if kind not in FORMS:
        if not kind:
            raise DeploymentError(f"expected {', '.join(FORMS.values())}", place)
        raise DeploymentError(f"there is no change {kind!r}{did_you_mean(kind, FORMS)}", place)
    epoch = _epoch(number.strip(), place)
    if kind == "attach" and rest:
        return epoch, read_attach(rest, deployment)
    name, colon, rest = rest.partition(":")
    if kind == "replace" and name and rest:
        return epoch, read_replace(rest, name, deployment)
    if kind == "detach" and name and (not colon or rest == "cascade"):
        return epoch, Detach(name, bool(colon))
    raise DeploymentError(f"expected {FORMS[kind]}", place)


def _epoch(text: str, place: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > _DIGITS or int(text) == 0:
        raise DeploymentError(f"expected the number of an epoch, from 1, got {text!r:.40}", place)
    return int(text)
