"""A hierarchy's engines on a network that delivers in any order, while attempts, processes and nodes come and go.

All that happens follows from one seed. What must come of it is `formal_run`, which knows no engine.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import NamedTuple

from hierax.runtime.core.digest import NO_DIGEST, DigestChain, encode_state, formal_digest
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, ActiveNode, update
from hierax.runtime.engine.effects import Called, Committed, Completed, EngineEffects, Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.table import Phase, Verdict
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.schemas.messages import DIGEST_BYTES, Header, Message, decode_message, encode_message
from hierax.schemas.values import decode_value, encode_value
from support.hierarchies import with_one_less, with_one_more, without

STEPS = 40_000
"""After so many of them a run does not end any more."""

CALLS = 8
"""A process that is to die does so within so many calls of its engine."""


class Faults(NamedTuple):
    """How likely each thing is: at each step, for `changes` in each epoch, for `dropped` in each attempt.

    Attributes:
        doubling: that what was delivered before comes again.
        loss: that a message is lost.
        again: that the world begins the epoch again.
        crashes: that a process dies.
        hangs: that a node's process is taken for lost while it lives.
        leaves: that a node whose process has died is taken out, if it can be.
        changes: that a node comes or goes.
        dropped: that a version is prepared and never used.
        most: how many there are of `again`, `crashes` and `hangs` together in an epoch.
    """

    doubling: float = 0.0
    loss: float = 0.0
    again: float = 0.0
    crashes: float = 0.0
    hangs: float = 0.0
    leaves: float = 0.0
    changes: float = 0.0
    dropped: float = 0.0
    most: int = 3


class DiedError(Exception):
    """A process was killed."""


@dataclass(frozen=True)
class Version:
    """A roster: the hierarchy, and how its nodes stand in it."""

    hierarchy: Hierarchy
    place: Place

    @staticmethod
    def of(hierarchy: Hierarchy, version: int, instances: Mapping[str, int]) -> Version:
        """A version; its hash covers the names of nodes and edges only."""
        pairs = hierarchy.bound_edges
        tasking = frozenset(pair for pair, edge in pairs.items() if edge.task)
        content = encode_value((sorted(hierarchy.nodes), sorted(pairs)))
        digest = blake2b(content, digest_size=DIGEST_BYTES).digest()
        return Version(hierarchy, Place(version, digest, dict(instances), tasking))

    def wiring(self, name: str) -> Wiring:
        """Of a node."""
        return Wiring(self.hierarchy.bound[name], tuple(self.hierarchy.bound_edges.values()), self.place)


class Site(EngineEffects):
    """A process with its engine; what it has kept survives it."""

    def __init__(self, network: Network, wiring: Wiring, saved: Saved | None, joins: bool, events: bool) -> None:
        self.network = network
        self.name = wiring.node.name
        self.instance = wiring.instance
        self.kept = saved
        self.last: Completed | None = None
        self.calls_left = -1
        self.alive = True
        self.asked: set[int] = set()
        self.engine = Engine(wiring, self, saved=saved, joins=joins)
        self.engine.events = events

    def send(self, message: Message) -> None:
        self._may_die()
        self.network.post(encode_message(message))

    def save(self, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        self._may_die()
        states = [ActiveNode(*decode_value(state)) for state in (start, now)]
        self.kept = Saved(epoch, attempt, *states)

    def act(self, epoch: int, actions: object) -> None:
        self._may_die()

    def committed(self, committed: Committed) -> None:
        self._may_die()
        self.network.commit(committed)

    def completed(self, completed: Completed) -> None:
        self._may_die()
        self.last = completed

    def refused(self, header: Header, verdict: Verdict) -> None:
        self.network.refused(self, header, verdict)

    def lacks(self, version: int) -> None:
        self.network.asked(self, version)

    def called(self, called: Called) -> None:
        self.network.calls.append((called.subject, called.operator))

    def _may_die(self) -> None:
        if not self.alive:
            raise DiedError
        self.calls_left -= 1
        if self.calls_left == 0:
            self.alive = False
            raise DiedError


class Epoch(NamedTuple):
    """A committed epoch: under which hierarchy, its digest, and all nodes' states."""

    hierarchy: Hierarchy
    attempt: int
    digest: bytes
    states: Mapping[str, bytes]


class Network:
    """The engines, what is under way between them, and the one who decides on attempts and versions.

    Args:
        hierarchy: at the beginning.
        seed: of all that happens.
        faults: how likely what is.
        events: whether calls of operators are kept in `calls`.
    """

    def __init__(self, hierarchy: Hierarchy, seed: int, faults: Faults, *, events: bool = False) -> None:
        self.calls: list[tuple[str, str]] = []
        self.happened: list[str] = []
        self.epochs: list[Epoch] = []
        self._random = random.Random(seed)
        self._faults = faults
        self._events = events
        self._world = hierarchy.world
        self._instances = dict.fromkeys(hierarchy.nodes, 0)
        self._versions = {0: Version.of(hierarchy, 0, self._instances)}
        self._in_force = self._newest = 0
        self._sites = {name: self._site(name, None) for name in hierarchy.nodes}
        self._hung: list[Site] = []
        self._chain = DigestChain(self._versions[0].place.roster_hash)
        self._tentative: Committed | None = None
        self._record = (0, 0, self._sites[self._world].engine.state)
        self._under_way: list[bytes] = []
        self._delivered: list[bytes] = []
        self._handings: list[tuple[Site, int]] = []
        self._limit = 0
        self._left = faults.most

    def run(self, epochs: int) -> None:
        """Until so many epochs are committed.

        Raises:
            AssertionError: nothing more can happen before that, or something happens that never may.
        """
        self._limit = epochs
        self._proceed()
        for _ in range(STEPS):
            if len(self.epochs) == epochs:
                return
            self._step()
            self._proceed()
        raise AssertionError(f"no end after {STEPS} steps: {self._waiting()}")

    # --- what engines do

    def post(self, data: bytes) -> None:
        """A message goes out."""
        if self._random.random() < self._faults.loss:
            self._delivered.append(data)  # a double of it may come for all that
        else:
            self._under_way.append(data)

    def commit(self, committed: Committed) -> None:
        """The world has committed; it counts when it has also begun the next epoch."""
        self._tentative = committed

    def refused(self, site: Site, header: Header, verdict: Verdict) -> None:
        """Only what is of an older roster, and doubles beyond what is held."""
        older = verdict is Verdict.OLD_ROSTER and header.roster < site.engine.wiring.roster
        assert older or verdict is Verdict.NEW_ROSTER, f"{site.name} refused {header}: {verdict}"

    def asked(self, site: Site, version: int) -> None:
        """A node asks for a roster; it gets one that names its own process."""
        if version not in site.asked:
            site.asked.add(version)
            self._handings.append((site, version))

    # --- what happens

    def _step(self) -> None:
        if self._disturbed():
            return
        count = len(self._under_way) + len(self._handings)
        if not count:
            self._quiet()
            return
        if self._delivered and self._random.random() < self._faults.doubling:
            self._deliver(self._random.choice(self._delivered))
            return
        index = self._random.randrange(count)
        if index >= len(self._under_way):
            self._hand(*self._handings.pop(index - len(self._under_way)))
            return
        data = self._under_way.pop(index)
        self._delivered.append(data)
        self._deliver(data)

    def _deliver(self, data: bytes) -> None:
        message = decode_message(data)
        receiver = message.header.receiver
        hung = [site for site in self._hung if site.name == receiver]
        for site in (*hung, *(site for name, site in self._sites.items() if name == receiver)):
            if site.alive:
                try:
                    site.engine.receive(message)
                except DiedError:
                    self.happened.append(f"{site.name} died")

    def _hand(self, site: Site, version: int) -> None:
        """A node gets a version of the roster; a process that it does not name is at its end."""
        place = self._versions[version]
        if site.name not in place.hierarchy.nodes or place.place.instance(site.name) != site.instance:
            site.alive = False
        if site.alive:
            try:
                site.engine.prepare(place.wiring(site.name))
            except DiedError:
                self.happened.append(f"{site.name} died")

    def _disturbed(self) -> bool:
        faults = self._faults
        draw = self._random.random()
        if draw > faults.again + faults.crashes + faults.hangs or not self._left:
            return self._random.random() < 0.1 and self._rejoin()
        self._left -= 1
        if draw < faults.again:
            self._again()
            return True
        site = self._sites[self._random.choice(sorted(self._sites))]
        if draw < faults.again + faults.crashes:
            site.calls_left = self._random.randint(0, CALLS) or -1
            if site.calls_left < 0:
                site.alive = False
                self.happened.append(f"{site.name} died")
            return True
        if site.name != self._world and site.alive:  # that of the world is killed before another one is started
            self._hung.append(site)
            self.happened.append(f"{site.name} hung")
            self._replace_process(site.name)
        return True

    def _again(self) -> None:
        world = self._sites[self._world]
        if world.alive and world.engine.phase is not Phase.DONE:
            self._begin(world.engine.epoch, self._record[1] + 1)
            self.happened.append(f"epoch {self._record[0]} again, attempt {self._record[1]}")

    def _rejoin(self) -> bool:
        lost = sorted(name for name, site in self._sites.items() if not site.alive)
        if not lost:
            return False
        name = self._random.choice(lost)
        left = without(self._latest, name) if self._random.random() < self._faults.leaves else None
        if left is None:
            self._replace_process(name)
        else:
            self._leave(name, left)
        return True

    def _quiet(self) -> None:
        """Nothing is under way: what was lost is to come, in one way or another."""
        if self._rejoin():
            return
        assert self._faults.loss or self._faults.crashes, f"stuck: {self._waiting()}"
        before = len(self._under_way), len(self._delivered)
        hierarchy = self._versions[self._in_force].hierarchy
        here = {name for name, site in self._sites.items() if self._is_here(site)}
        for name, site in self._sites.items():
            senders = {sender for sender, _ in site.engine.waits_for} if name in here else {*hierarchy.below(name)}
            for sender in sorted(senders & here):
                self._sites[sender].calls_left = -1  # it is to live for this
                self._sites[sender].engine.resend([name])
        assert before != (len(self._under_way), len(self._delivered)), f"stuck: {self._waiting()}"

    def _is_here(self, site: Site) -> bool:
        """Whether a node has heard of the attempt under way."""
        return (site.engine.epoch, site.engine.attempt) == self._record[:2]

    # --- what the owner of the roster does

    @property
    def _latest(self) -> Hierarchy:
        """In force, or about to be."""
        return self._versions[self._newest].hierarchy

    def _proceed(self) -> None:
        """The next epoch begins if the last one is committed; only then that one counts."""
        while self._sites[self._world].alive and len(self.epochs) < self._limit:
            world = self._sites[self._world].engine
            if world.phase is not Phase.DONE:
                return
            if self._tentative is not None:
                self._count(self._tentative)
                self._tentative = None
            if len(self.epochs) < self._limit:
                if self._random.random() < self._faults.changes:
                    self._change()
                self._begin(world.epoch + 1, 0)

    def _count(self, committed: Committed) -> None:
        """Nothing of an epoch is left to do when it is committed."""
        version = self._versions[self._in_force]
        assert committed.epoch == len(self.epochs) + 1, "an epoch was committed twice, or left out"
        assert committed.attempt == self._record[1], "an attempt was committed that is not the last one"
        states = {}
        for name in version.hierarchy.nodes:
            site = self._sites[name]
            engine, last = site.engine, site.last
            if last is not None and (last.step.epoch, last.step.attempt) == committed[:2]:
                states[name] = last.state
            else:  # then it died when its last message was out
                assert not site.alive, f"{name} has not completed the epoch: {self._waiting()}"
            assert not site.alive or (engine.phase, engine.epoch, engine.attempt) == (Phase.DONE, *committed[:2])
        self._left = self._faults.most
        digest = self._chain.commit(committed.epoch, committed.digest)
        self.epochs.append(Epoch(version.hierarchy, committed.attempt, digest, states))

    def _begin(self, epoch: int, attempt: int) -> None:
        """Begin an epoch or attempt under the latest version."""
        world = self._sites[self._world]
        engine = world.engine
        latest = self._newest
        try:
            if latest != engine.wiring.roster:
                engine.prepare(self._versions[latest].wiring(self._world))
                engine.rewire(latest)
            self._in_force = latest
            self._chain.roster_hash = self._versions[latest].place.roster_hash
            again = engine.phase is not Phase.DONE
            self._record = (epoch, attempt, engine.start if again else engine.state)
            if again:
                engine.begin_again(attempt)
            else:
                engine.begin(attempt)
        except DiedError:
            self.happened.append(f"{self._world} died")
        if self._random.random() < self._faults.dropped:
            self._drop()

    def _replace_process(self, name: str) -> None:
        """A new process of a node goes on with what the old one kept, and the epoch is begun again."""
        old = self._sites[name]
        self._instances[name] += 1
        version = self._prepare(self._latest)
        self.happened.append(f"{name} is back in version {version}")
        if name != self._world:
            self._sites[name] = self._site(name, old.kept, joins=old.kept is None)
            self._again()
            return
        epoch, attempt, state = self._record
        self._tentative = None
        counts = self.epochs[epoch - 2].attempt if epoch > 1 else 0
        self._sites[name] = self._site(name, Saved(epoch - 1, counts, state, state))
        self._begin(epoch, attempt + 1)

    def _prepare(self, hierarchy: Hierarchy) -> int:
        """A new version; some get it now, some by and by, some when they ask for it."""
        version = self._newest = max(self._versions) + 1
        self._versions[version] = Version.of(hierarchy, version, self._instances)
        for name, site in self._sites.items():
            named = name in hierarchy.nodes and site.instance == self._instances[name]
            way = self._random.randrange(4) if named and site.alive else 3
            if way < 2:
                site.engine.prepare(self._versions[version].wiring(name))
            elif way == 2:
                self.asked(site, version)
        return version

    def _change(self) -> None:
        """A node comes, or goes, before the next epoch."""
        hierarchy = self._latest
        rng = self._random
        changed = with_one_less(rng, hierarchy) if rng.random() < 0.5 else None
        if changed is None:
            changed = with_one_more(rng, hierarchy)
        (name,) = hierarchy.nodes.keys() ^ changed.nodes.keys()
        self.happened.append(f"{name} {'comes' if name in changed.nodes else 'goes'} after epoch {len(self.epochs)}")
        if name in changed.nodes:
            self._instances[name] = self._instances.get(name, -1) + 1
            self._prepare(changed)
            self._sites[name] = self._site(name, None, joins=True)
        else:
            self._hung.append(self._sites.pop(name))  # it does not know yet
            self._prepare(changed)

    def _leave(self, name: str, left: Hierarchy) -> None:
        """A node whose process is lost is taken out, in the middle of an epoch, which is begun again."""
        self.happened.append(f"{name} is given up")
        del self._sites[name]
        self._prepare(left)
        self._again()

    def _drop(self) -> None:
        """A version is prepared by some, while they wait for another one, and comes to nothing."""
        newest = self._newest
        smaller = with_one_less(self._random, self._latest)
        if smaller is not None:
            version = self._prepare(smaller)
            self._newest = newest
            self.happened.append(f"version {version} is dropped")

    def _site(self, name: str, saved: Saved | None, joins: bool = False) -> Site:
        wiring = self._versions[self._newest].wiring(name)
        return Site(self, wiring, saved, joins, self._events)

    def _waiting(self) -> str:
        lines = [f"versions {sorted(self._versions)}, record {self._record[:2]}", *self.happened]
        for name, site in sorted(self._sites.items()):
            engine = site.engine
            where = f"{engine.epoch}.{engine.attempt} roster {engine.wiring.roster}"
            lines.append(f"{name} alive={site.alive} {where} {engine.phase}: waits for {engine.waits_for}")
        return "\n".join(lines)


def formal_run(hierarchies: Sequence[Hierarchy]) -> list[tuple[bytes, dict[str, bytes]]]:
    """What the formal core says of a run: each epoch's digest and all nodes' states.

    Args:
        hierarchies: that of each epoch.
    """
    active = ActiveHierarchy.initial(hierarchies[0])
    digest = NO_DIGEST
    result = []
    for hierarchy in hierarchies:
        if hierarchy is not active.hierarchy:
            initial = ActiveHierarchy.initial(hierarchy).states
            states = {name: active.states.get(name, initial[name]) for name in hierarchy.nodes}
            active = ActiveHierarchy(hierarchy, states, active.epoch)
        active = update(active)
        digest = formal_digest(active, digest, Version.of(hierarchy, 0, {}).place.roster_hash)
        states_of = {name: encode_state(*state) for name, state in active.states.items()}
        result.append((digest, states_of))
    return result
