"""``--at EPOCH:CHANGE``: changes of the roster at epochs that are known before the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hierax.runtime.deployment.deployment import Deployment, RestartPolicy
from hierax.runtime.deployment.paths import DeploymentError
from hierax.runtime.deployment.snippet import read_attach, read_replace, read_restarts
from hierax.runtime.loading.allowance import NotAllowedError
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.owner.roster_changes import ChangeError, apply
from hierax.schemas.roster import Change, Detach, Roster

FORMS = {"attach": "EPOCH:attach:FILE", "detach": "EPOCH:detach:NAME[:cascade]", "replace": "EPOCH:replace:NAME:FILE"}
"""How each change is written."""

_DIGITS = 19


class Scheduled(NamedTuple):
    """A change that is known before the run, and takes effect at the start of an epoch."""

    epoch: int
    change: Change
    alone: frozenset[str] = frozenset()  # its new nodes that are detached when a function of theirs raises


def read_schedule(texts: Sequence[str], deployment: Deployment) -> tuple[Scheduled, ...]:
    """Changes, sorted by the epoch at whose start each takes effect; those of one epoch are made in the given order.
    The texts are as ``--at`` has them, see `FORMS`; ``FILE`` is a snippet, or in an attach the name of a node of the
    deployment file. Changes are tried on the deployment's roster, so that none is refused in the middle of a run.
    Raises `DeploymentError` if one is written wrongly, its snippet is wrong, or it cannot be made."""
    read = [(_read(text, deployment), text) for text in texts]
    read.sort(key=lambda entry: entry[0].epoch)
    roster = deployment.roster
    for scheduled, text in read:
        roster = _after(scheduled.change, roster, deployment, f"--at {text}")
    return tuple(scheduled for scheduled, _ in read)


def _after(change: Change, roster: Roster, deployment: Deployment, place: str) -> Roster:
    version = roster.version + 1
    try:
        deployment.allowance.check_all(change)
        return apply(roster, change, version, lambda _: version)
    except (ChangeError, NotAllowedError) as error:
        raise DeploymentError(str(error), place) from error


def _read(text: str, deployment: Deployment) -> Scheduled:
    place = f"--at {text}"
    number, _, rest = text.partition(":")
    kind, _, rest = rest.partition(":")
    kind = kind.strip()
    if kind not in FORMS:
        if not kind:
            raise DeploymentError(f"expected {', '.join(FORMS.values())}", place)
        raise DeploymentError(f"there is no change {kind!r}{did_you_mean(kind, FORMS)}", place)
    number = number.strip()
    if not number.isascii() or not number.isdigit() or len(number) > _DIGITS or int(number) == 0:
        raise DeploymentError(f"expected the number of an epoch, from 1, got {number!r:.40}", place)
    epoch = int(number)
    if kind == "attach" and rest:
        alone = _alone(read_restarts(rest, deployment, attached=True))
        return Scheduled(epoch, read_attach(rest, deployment), alone)
    name, colon, rest = rest.partition(":")
    if kind == "replace" and name and rest:
        return Scheduled(epoch, read_replace(rest, name, deployment), _alone(read_restarts(rest, deployment)))
    if kind == "detach" and name and (not colon or rest == "cascade"):
        return Scheduled(epoch, Detach(name, bool(colon)))
    raise DeploymentError(f"expected {FORMS[kind]}", place)


def _alone(policies: Mapping[str, RestartPolicy]) -> frozenset[str]:
    return frozenset(name for name, policy in policies.items() if policy.fails_alone)
