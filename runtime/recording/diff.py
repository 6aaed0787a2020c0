"""The first place where two runs differ: epoch, node or edge, operator, and field.

In each epoch results are compared in the formal order: upward each node's `observe` and its edges' `sense`, downward
its `select_policy`, policy, `task`, `predict` and `context`. So everything that went into the first one that differs
was the same."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from hierax.runtime.core.difference import ABSENT, first_unlike
from hierax.runtime.core.digest import EDGE_FUNCTIONS
from hierax.runtime.core.elements import Value
from hierax.runtime.core.graph import neighbours
from hierax.runtime.recording.replayed_epoch import ReplayedEpoch
from hierax.runtime.recording.trace import EpochTrace, taking_part
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.roster import Roster

EpochView = EpochTrace | ReplayedEpoch  # an epoch as it can be compared, recorded or replayed


class Difference(NamedTuple):
    """Where two runs differ first: in which epoch, at which path of a field, and what is there in each run."""

    epoch: int
    subject: str  # the node, or the edge as ``lower->upper``
    operator: str  # or policy, as ``policy NAME``, or edge function; ``time`` or ``digest`` where that is all
    path: str
    a: Value
    b: Value


class RosterDifference(NamedTuple):
    """Where two rosters differ."""

    epoch: int
    path: str
    a: Value
    b: Value


@dataclass
class Comparison:
    """What became of a comparison of two runs."""

    epochs: int = 0  # that are on both sides, up to the first difference
    equal: int = 0  # how many of them were
    last: int = 0  # the last epoch that was compared; 0: none
    difference: Difference | None = None  # the first one
    rosters: list[RosterDifference] = field(default_factory=list)  # where they differ, the first time that they do
    unknown: int = 0  # how many results one of both did not tell, so that they were not compared
    digests: int = 0  # how many digests were compared

    @property
    def alike(self) -> bool:
        """Whether no difference was found."""
        return self.difference is None and not self.rosters


def compare(a: Iterable[EpochView], b: Iterable[EpochView], tolerance: float = 0.0) -> Comparison:
    """Compare the epochs that both have, in the order of their numbers, up to the first difference. The runs' digests
    are compared where the rosters were equal so far, but with a tolerance of numbers, as `first_unlike` has it, they
    are not."""
    result = Comparison()
    for left, right in _paired(iter(a), iter(b)):
        result.epochs += 1
        result.last = left.epoch
        if not result.rosters:
            result.rosters = roster_differences(left.epoch, left.roster, right.roster)
        result.difference = next(_differences(left, right, tolerance, result), None)
        if result.difference is None and not (tolerance or result.rosters) and left.digest and right.digest:
            result.digests += 1
            if left.digest != right.digest:
                result.difference = Difference(left.epoch, "run", "digest", "digest", left.digest, right.digest)
        if result.difference is not None:
            break
        result.equal += 1
    return result


def roster_differences(epoch: int, a: Roster, b: Roster) -> list[RosterDifference]:
    """Where the contents of two rosters differ: nodes and edges, each once."""
    left, right = _parts(a), _parts(b)
    paths = sorted(left.keys() | right.keys(), key=lambda path: (path.startswith("edges."), path))
    found = (first_unlike(left.get(path, ABSENT), right.get(path, ABSENT), path) for path in paths)
    return [RosterDifference(epoch, *unlike) for unlike in found if unlike is not None]


def _paired(a: Iterator[EpochView], b: Iterator[EpochView]) -> Iterator[tuple[EpochView, EpochView]]:
    left, right = next(a, None), next(b, None)
    while left is not None and right is not None:
        first = min(left.epoch, right.epoch)
        if left.epoch == right.epoch:
            yield left, right
        left = next(a, None) if left.epoch == first else left
        right = next(b, None) if right.epoch == first else right


def _differences(a: EpochView, b: EpochView, tolerance: float, result: Comparison) -> Iterator[Difference]:
    epoch = a.epoch
    if a.time_s is not None and b.time_s is not None and a.time_s != b.time_s:
        yield Difference(epoch, a.roster.world, "time", "time_s", a.time_s, b.time_s)
    below, above = neighbours({*a.roster.pairs} & {*b.roster.pairs})
    names = [name for name in a.order if name in b.roster.nodes]
    doing = {name for each in (a, b) for name in taking_part(each.roster, epoch)}

    def unlike(subject: str, operator: str, path: str, left: Value, right: Value) -> Iterator[Difference]:
        if left is None or right is None:
            result.unknown += 1
            return
        found = first_unlike(left[0], right[0], path, tolerance)
        if found is not None:
            yield Difference(epoch, subject, operator, *found)

    def line(kind: str, sender: str, receiver: str) -> Iterator[Difference]:
        subject = f"{sender}->{receiver}" if kind == OBSERVATIONS else f"{receiver}->{sender}"
        given = [each.elements(kind, sender, receiver) for each in (a, b)]
        left, right = (None if elements is None else (elements,) for elements in given)
        yield from unlike(subject, EDGE_FUNCTIONS[kind], "elements", left, right)

    for name in names:
        starts = a.start_of(name), b.start_of(name)
        if None not in starts:
            which = "initial_belief" if epoch == 1 else "start"
            yield from unlike(name, which, "belief", *((start.belief,) for start in starts if start))
        yield from _used_unlike(a, b, name, upward=True)
        if name != a.roster.world and name in doing:
            yield from unlike(name, "observe", "belief", a.sensed_of(name), b.sensed_of(name))
        for upper in above.get(name, ()):
            if _is_sensed(a.roster, name, upper, epoch) or _is_sensed(b.roster, name, upper, epoch):
                yield from line(OBSERVATIONS, name, upper)
    for name in reversed([name for name in names if name in doing]):
        yield from _used_unlike(a, b, name, upward=False)
        states = [state for state in (a.state_of(name), b.state_of(name)) if state is not None]
        result.unknown += len(states) < 2
        if len(states) == 2:
            yield from unlike(name, "select_policy", "policy", *((state.policy,) for state in states))
            yield from unlike(name, f"policy {states[0].policy}", "actions", *((state.actions,) for state in states))
        for lower in below.get(name, ()):
            if (lower, name) in a.roster.tasking & b.roster.tasking:
                yield from line(TASKS, name, lower)
        if len(states) == 2:
            yield from unlike(name, "predict", "belief", *((state.belief,) for state in states))
        for lower in below.get(name, ()):
            yield from line(CONTEXT, name, lower)


def _is_sensed(roster: Roster, lower: str, upper: str, epoch: int) -> bool:
    return roster.rates is None or roster.rates.is_sensed(lower, upper, epoch)


def _used_unlike(a: EpochView, b: EpochView, name: str, upward: bool) -> Iterator[Difference]:
    """Where epochs overlap, inputs of other epochs are what makes results differ."""
    left, right = a.used_of(name) or {}, b.used_of(name) or {}
    for slot in sorted(left.keys() & right.keys()):
        sender, kind = slot
        if (kind == OBSERVATIONS) == upward and left[slot][0] != right[slot][0]:
            path = f"epoch of the {kind} message {sender} -> {name}"
            yield Difference(a.epoch, name, "inputs", path, left[slot][0], right[slot][0])


def _parts(roster: Roster) -> dict[str, Value]:
    """Nodes and edges by path."""
    content = roster.content()
    turns = {f"nodes.{name}.turns": turns for name, turns in content.get("turns", {}).items()}
    nodes = {f"nodes.{name}": node for name, node in content["nodes"].items()} | turns
    return nodes | {f"edges.{edge['lower']} -> {edge['upper']}": edge for edge in content["edges"]}
