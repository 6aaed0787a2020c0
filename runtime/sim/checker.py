"""What must hold, whatever happens: checked against the formal core, apart from the engine."""

from collections import Counter
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import NO_DIGEST, encode_state, formal_digest
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, ActiveNode, update
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.sim.inspection import Turn
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.scenario import Scenario
from hierax.schemas.messages import Header
from hierax.schemas.roster import Change, Detach, Roster, new_nodes
from hierax.schemas.values import encode_value

States = Mapping[str, ActiveNode]


class ViolationError(Exception):
    """Something that must hold does not."""


class Start(NamedTuple):
    """How an epoch begins under a version of the roster, by the formal core."""

    roster: Roster  # of the version
    states: States  # of its nodes
    encoded: Mapping[str, bytes]  # the states' bytes


class End(NamedTuple):
    """How an epoch ends, by the formal core."""

    epoch: int
    roster: Roster
    states: States
    digest: bytes


class Checker:
    """Follows a run with the formal core."""

    def __init__(self, scenario: Scenario, trace: Callable[[str], None]) -> None:
        self._scenario = scenario  # of the simulation
        self._trace = trace  # told the commits
        self._setting = OperatorSetting(scenario.seed)
        self._hierarchies: dict[bytes, Hierarchy] = {}
        self._processes: dict[int, Mapping[str, str]] = {}
        self._rosters: dict[int, Roster] = {}
        self._starts: dict[tuple[int, int], Start] = {}
        self._ends: list[End] = []
        self._undone: set[tuple[int, int]] = set()
        self._begun: dict[tuple[int, int], int] = {}
        self._beginnings = 0
        self._candidates: dict[int, End] = {}
        self.acts: Counter[int] = Counter()
        self.excused = False  # whether a run may give up: a slot was damaged, or somebody else spoke in a node's name
        self.foretold = False  # whether a node was told of an attempt that nobody has begun, and may be there
        self.uncertain: set[int] = set()  # epochs in whose act, or record of it, the world's process died
        self.version = -1
        self._in_force = {scenario.roster.version: scenario.roster}
        self._came: dict[str, int] = {}
        self._acted_under = (0, scenario.roster)
        self._may_go = {each.change.name for each in scenario.proposals if isinstance(each.change, Detach)}
        self._missable = {*scenario.on_loss, *(name for each in scenario.proposals for name in each.on_loss)}
        if not scenario.together:
            self._may_go |= self._missable  # they may come too late
        hierarchy = self.hierarchy_of(scenario.roster)
        states = ActiveHierarchy.initial(hierarchy).states
        self._ends.append(End(0, scenario.roster, states, NO_DIGEST))

    @property
    def told(self) -> int:
        """The last epoch whose digest anybody outside knows."""
        return len(self._ends) - 1

    def violate(self, what: str) -> None:
        """Something is wrong: raises `ViolationError`."""
        raise ViolationError(what)

    def hierarchy_of(self, roster: Roster) -> Hierarchy:
        content = encode_value(roster.content())
        if content not in self._hierarchies:
            self._hierarchies[content] = build_hierarchy(roster, self._setting, Allowance((MODULE,)))
        return self._hierarchies[content]

    def process_of(self, version: int, name: str) -> str | None:
        """The token of the process that runs a node under a version."""
        return self._processes.get(version, {}).get(name)

    def had_place(self, token: str) -> bool:
        """Whether a process has had a place in a roster in force."""
        return any(token in processes.values() for processes in self._processes.values())

    def prepared(self, roster: Roster) -> None:
        """A process is told of a version: no number is used for two rosters."""
        if not self._rosters.setdefault(roster.version, roster).is_as(roster):
            self.violate(f"two rosters have version {roster.version}")

    def begins(self, base: int, turn: Turn, roster: Roster, processes: Mapping[str, str]) -> None:
        """The world is told to begin a turn; from now on this roster is in force, and was of version `base` before."""
        self._beginnings += 1
        self.version = turn.version
        if turn.epoch != self.told + 1 and turn.epoch - 1 not in self._candidates:
            self.violate(f"epoch {turn.epoch} begins, {self.told} was the last that was committed")
        self._processes[turn.version] = dict(processes)
        if base != turn.version:
            before = self._in_force[base]
            self._check_settled(turn.epoch, roster)
            self._check_detached(before, roster)
            for name, reference in roster.nodes.items():
                if before.nodes.get(name) != reference:
                    self._came[name] = turn.version
        self._in_force[turn.version] = roster
        key = (turn.epoch, turn.version)
        if key not in self._starts:
            self._starts[key] = self._start(turn, base, roster)

    def sends(self, header: Header) -> None:
        """A message goes out: no attempt's number is used for two of them."""
        is_world = header.sender == self._scenario.roster.world
        if is_world and self._begun.setdefault((header.epoch, header.attempt), self._beginnings) != self._beginnings:
            self.violate(f"attempt {header.attempt} of epoch {header.epoch} is begun twice")

    def starts(self, name: str, token: str, state: ActiveNode, turn: Turn) -> None:
        """A node begins a turn in this state."""
        start = self._starts.get((turn.epoch, turn.version))
        if start is None and (turn.epoch <= self.told or (turn.epoch, turn.version) in self._undone):
            return  # of a process that was cut off, and takes in what had come before
        if start is None or name not in start.encoded:
            self.violate(f"{token} begins {turn}, which it has no part in")
        elif encode_state(*state) != start.encoded[name]:
            self.violate(f"{token} begins {turn} with {state}, expected {start.states[name]}")

    def lost(self, name: str) -> None:
        """A process of a node is dead, or taken for that: where it is not missed, it may be detached."""
        if name in self._missable:
            self._may_go.add(name)

    def raised(self, ends: list[str]) -> None:
        """An operator or edge function has raised: of these, which fail alone, what came last is to blame."""
        self._may_go.add(max(ends, key=lambda name: self._came.get(name, 0)))

    def acted(self, epoch: int) -> None:
        self.acts[epoch] += 1
        self._acted_under = (epoch, self._in_force[self.version])

    def commits(self, turn: Turn, encoded: Mapping[str, bytes]) -> None:
        """The world's engine has committed an epoch, with these living processes' states; it counts when it is told."""
        start = self._starts[turn.epoch, turn.version]
        hierarchy = self.hierarchy_of(start.roster)
        active = update(ActiveHierarchy(hierarchy, MappingProxyType(dict(start.states)), turn.epoch - 1))
        for name, state in active.states.items():
            if name in encoded and encoded[name] != encode_state(*state):  # one that is dead has finished, too
                self.violate(f"{name}: its state after epoch {turn.epoch} is not {state}")
        digest = formal_digest(active, self._after(turn.epoch - 1).digest, start.roster.content_hash())
        self._candidates[turn.epoch] = End(turn.epoch, start.roster, active.states, digest)

    def publishes(self, epoch: int, digest: bytes) -> None:
        """The digest of a committed epoch is published."""
        end = self._candidates.pop(epoch, None)
        if end is None or epoch != self.told + 1:
            self.violate(f"epoch {epoch} is committed, the last one was {self.told}")
            return
        if digest != end.digest:
            self.violate(f"the digest of epoch {epoch} is {digest.hex()[:8]}, expected {end.digest.hex()[:8]}")
        self._ends.append(end)
        self._starts = {key: start for key, start in self._starts.items() if key[0] > epoch}
        self._trace(f"epoch {epoch} is committed: {digest.hex()[:8]}")

    def resumes(self, epoch: int, digest: bytes) -> None:
        """The world's new process goes on with an epoch, after this digest of the last one."""
        if self.told + 1 == epoch - 1 and epoch - 1 in self._candidates:  # it was recorded, and nobody was told
            self.publishes(epoch - 1, digest)
        if epoch != self.told + 1 and not self.excused:
            self.violate(f"the world goes on with epoch {epoch}, {self.told} was the last that was told")
        self._candidates = {}
        self._undone.update(key for key in self._starts if key[0] > epoch)
        self._starts = {key: start for key, start in self._starts.items() if key[0] <= epoch}
        del self._ends[max(epoch, 1) :]

    def finishes(self, answers: Mapping[str, str], encoded: Mapping[str, bytes]) -> None:
        """The run is over, with these living processes' states: whether all was done as was said of the changes
        (``epoch N``, or why not)."""
        self._check_acts()
        for proposal in self._scenario.proposals:
            answer, change = answers[proposal.key], proposal.change
            refused = not answer.startswith("epoch ") and not isinstance(change, Detach)
            if refused and _holds(change, self._ends[-1].roster):  # no two changes of a scenario make the same node
                self.violate(f"{proposal.key} is said to be refused ({answer}), and holds")
            if not answer.startswith("epoch ") or list(answers.values()).count(answer) > 1:
                continue  # refused, or another change of the same epoch may have undone it
            roster = self._ends[int(answer.removeprefix("epoch "))].roster
            if not _holds(change, roster):
                self.violate(f"{proposal.key} is said to hold from {answer} on, and does not")

    def _check_acts(self) -> None:
        if "ActingWorld" not in self._scenario.roster.nodes[self._scenario.roster.world].target:
            return
        for epoch in range(1, self.told + 1):
            acts = self.acts[epoch]
            if epoch not in self.uncertain and acts != 1:
                self.violate(f"epoch {epoch} was acted {acts} times")
            if self._scenario.on_uncertain_act == "repeat" and acts < 1:
                self.violate(f"epoch {epoch} was never acted, and acts are repeated")
            if self._scenario.on_uncertain_act == "skip" and acts > 1:
                self.violate(f"epoch {epoch} was acted {acts} times, and uncertain ones are skipped")

    def _check_settled(self, epoch: int, roster: Roster) -> None:
        """An epoch that was acted upon is done again with the same nodes, but for those that are lost."""
        acted, under = self._acted_under
        new = [name for name, reference in roster.nodes.items() if under.nodes.get(name) != reference]
        if acted == epoch and new:
            self.violate(f"epoch {epoch} was acted upon, and is done again with {sorted(new)}")

    def _check_detached(self, before: Roster, roster: Roster) -> None:
        """Nobody goes but who is to, and what only those join to the world."""
        staying = {before.world}
        for edge in (edge for _ in before.nodes for edge in before.edges):
            if edge.lower in staying and edge.upper not in self._may_go:
                staying.add(edge.upper)
        if not staying <= roster.nodes.keys():
            self.violate(f"{sorted(staying - roster.nodes.keys())} went, and nobody asked for that")

    def _after(self, epoch: int) -> End:
        """The end of an epoch that is committed, be it told already or not."""
        return self._candidates[epoch] if epoch in self._candidates else self._ends[epoch]

    def _start(self, turn: Turn, base: int, roster: Roster) -> Start:
        """What one change, at most, makes of the states before it."""
        last = self._after(turn.epoch - 1)
        before = self._starts.get((turn.epoch, base)) or last
        hierarchy = self.hierarchy_of(roster)
        now: dict[str, ActiveNode] = {}
        for name, reference in sorted(roster.nodes.items()):
            node = hierarchy.nodes[name]
            if name not in before.roster.nodes:
                now[name] = ActiveNode(node.initial_belief(), node.initial_policy)
            elif reference == before.roster.nodes[name]:
                now[name] = before.states[name]
            elif reference == last.roster.nodes.get(name):  # what replaced it has failed in this epoch
                now[name] = last.states[name]
            else:  # no two references of a scenario are equal
                state = before.states[name]
                now[name] = state._replace(belief=node.take_over(state.belief))
        return Start(roster, now, {name: encode_state(*state) for name, state in now.items()})


def _holds(change: Change, roster: Roster) -> bool:
    """Whether a roster is one after a change."""
    if isinstance(change, Detach):
        return change.name not in roster.nodes
    return all(roster.nodes.get(name) == reference for name, reference in new_nodes(change).items())
