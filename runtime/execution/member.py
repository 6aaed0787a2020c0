"""A node of a run that may change: its runner, with checkpoints, and ears for the roster's owner."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from hierax.runtime.core.errors import ContradictionError, HieraxError, OperatorError
from hierax.runtime.core.staleness import BARRIER, Staleness
from hierax.runtime.engine.effects import Completed, Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.table import MAX_PREPARED, ROSTERS_AHEAD, Phase, Verdict
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.checkpoints import Checkpoints, taken_over
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.runner import Host, NodeRunner, World
from hierax.runtime.loading.allowance import Refusals
from hierax.runtime.transport.port import Port
from hierax.schemas import control
from hierax.schemas.checkpoint import Checkpoint
from hierax.schemas.control import Control
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Header
from hierax.schemas.roster import Roster

REFUSED_TOLD = 32  # under one version of the roster, of how many senders and reasons refused messages are logged
MAX_RESENDS = 64
"""How often what was sent in an attempt is sent again: the owner asks for it a few times, then blames a link."""

_log = logging.getLogger("hierax")


@dataclass(frozen=True)
class Seat:
    """What a node's process has for its member, the world's or another one's."""

    name: str  # of the node
    process: str  # the process's token
    wire: Callable[[Roster], Wiring]  # makes the wiring of a roster's version; loads what it names
    port: Port  # of the node
    observers: Observers | None = None  # of the node; None: nobody observes it yet
    staleness: Staleness = BARRIER  # of the deployment
    alone: frozenset[str] = frozenset()  # the nodes that fail alone, until a roster comes that says otherwise


class Member(Host):
    """A node's process, as far as it is no matter of processes. It has a runner from when a roster with its node has
    come.

    What it is told to do raises `OperatorError` if an operator failed, and `ContradictionError` if it was told
    something else before."""

    def __init__(
        self, seat: Seat, report: Callable[[Control], None], checkpoints: Checkpoints, world: World | None = None
    ) -> None:
        self.name = seat.name
        self.process = seat.process
        self.port = seat.port
        self.observers = Observers(seat.name) if seat.observers is None else seat.observers
        self.staleness = seat.staleness
        self.runner: NodeRunner | None = None  # of the node; None: no roster with it has come yet
        self.dismissed = ""  # why the process is to end; empty: it is not
        self.again = False  # whether another one is to come in its place then
        self._world = world  # at the world's node; None at others
        self.alone = seat.alone  # the nodes that fail alone
        self.tried = frozenset[str]()  # likewise, until the end of the first epoch under the roster
        self._alone_in: dict[int, tuple[frozenset[str], frozenset[str]]] = {}
        self._tried_in: int | None = None
        self._failure: control.Failed | None = None
        self._wire_roster = seat.wire
        self._report = report  # tells the roster's owner something; it may be lost, then it is told again
        self._checkpoints = checkpoints  # of the node
        self._saved: Saved | None = None
        self._join: control.Join | None = None
        self._took = 0
        self._refused: set[tuple[str, str]] = set()
        self._linking: set[int] = set()
        self._linked: set[int] = set()
        self._fetched: set[int] = set()
        self._refusals = Refusals()
        seat.port.on_mended(self.mended)
        self._resent: tuple[tuple[int, int], int] = ((0, 0), 0)
        self._rosters: dict[int, Roster] = {}
        self._taken = (b"", b"")

    @property
    def engine(self) -> Engine | None:
        return None if self.runner is None else self.runner.engine

    @property
    def active(self) -> bool:
        """Whether this process has taken part in an epoch."""
        return self.runner is not None and self.runner.engine.begun

    def run(self, wiring: Wiring, saved: Saved | None = None, joins: bool = False) -> NodeRunner:
        """Have a runner from now on; the arguments are those of `Engine`."""
        parts = (self.port, self.observers, self, self._world)
        self.runner = NodeRunner(wiring, *parts, staleness=self.staleness, saved=saved, joins=joins)
        return self.runner

    def join(self, request: str = "") -> None:
        """Offer this process to the owner, or ask whether it is still wanted; to be called again while nothing comes.

        `request`: the change that it was started for; empty: it comes in the place of a process that had a place."""
        if self._failure is not None:
            self._report(self._failure)
        engine = self.engine
        if engine is not None and engine.begun:
            place = (engine.wiring.roster, engine.attempt)
            self._report(control.Join(self.name, self.process, "", engine.epoch, True, "", *place))
            return
        if self._join is None:
            self._join = self._offer(request)
        self._report(self._join)

    def recall(self, wiring: Wiring) -> None:
        """Have the state of the last epoch, after a run. Raises `HieraxError` if there is no whole checkpoint."""
        found = self._checkpoints.read()
        self.run(wiring, None if found is None else found[1])

    def take_word(self, word: Control) -> None:
        """Do what the owner says; what others say is nothing to this process."""
        if isinstance(word, control.Order):
            self.obey(word)

    def obey(self, order: control.Order) -> None:
        try:
            self.do(order)
        except OperatorError as error:
            self.failed(error)
        if self.runner is not None:
            self.runner.finish()

    def failed(self, error: OperatorError) -> None:
        engine = self.engine
        if engine is None or not (self.alone | self.tried_now).intersection(error.subject.split("->")):
            raise error
        _log.info("%s", error, exc_info=error)
        version = engine.wiring.roster
        self._failure = control.Failed(self.name, self.process, version, error.subject, str(error))
        self._report(self._failure)

    @property
    def tried_now(self) -> frozenset[str]:
        """The nodes that are tried in the epoch under way."""
        first, engine = self._tried_in, self.engine
        over = first is not None and engine is not None and engine.epoch > first
        return frozenset() if over or not self.tried else self.tried

    def completed(self, completed: Completed) -> None:
        if self._tried_in is None:
            self._tried_in = completed.step.epoch

    def do(self, order: control.Order) -> None:
        """Do what the owner says, but for what follows from it; as `obey` does."""
        if isinstance(order, control.Prepare):
            self._prepare(order)
        elif isinstance(order, control.Unchanged):
            self._go_on_as(order)
        elif isinstance(order, control.HandOver):
            self._hand_over(order)
        elif isinstance(order, control.TakeOver):
            self._take_over(order)
        elif isinstance(order, control.AskStatus):
            self._report(self.status(order.inquiry))
        elif isinstance(order, control.Resend):
            self._resend(order)
        elif isinstance(order, control.CatchUp):
            if isinstance(self.engine, RatedEngine) and self.engine.is_done_with(order.epoch):
                self._report(control.CaughtUp(self.name, self.process, order.epoch))
        elif isinstance(order, control.Dismiss):
            self.dismissed = order.why
            self.again = order.again
        else:
            unheard: NoReturn = order  # mypy finds an order that nobody obeys
            raise TypeError(unheard)

    def _resend(self, order: control.Resend) -> None:
        engine = self.engine
        if engine is None or not (engine.overlaps or (engine.epoch, engine.attempt) == (order.epoch, order.attempt)):
            return
        turn, count = self._resent
        count = count + 1 if turn == (order.epoch, order.attempt) else 1
        self._resent = ((order.epoch, order.attempt), count)
        if count <= MAX_RESENDS:
            engine.resend(order.receivers)

    def status(self, inquiry: int, busy: str = "") -> control.Status:
        """What the node waits for. Any thread may ask."""
        engine = self.engine
        if engine is None:
            return control.Status(self.name, inquiry, 0, 0, (), busy)
        goes_on = isinstance(engine, RatedEngine) and self._world is None  # when there are observations
        waits = () if engine.phase is Phase.DONE and not goes_on else engine.waits_for
        return control.Status(self.name, inquiry, engine.epoch, engine.attempt, waits, busy, engine.wiring.roster)

    def linked(self, version: int) -> None:
        """The port's links of a version are open, in both directions."""
        self._note_link(version)
        self._say_ready(version)

    def mended(self, neighbour: str) -> None:
        """The link to a neighbour broke and is there again: what it may lack is said again; it drops what is double."""
        _log.info("%s: the link to %s broke, and is there again", self.name, neighbour)
        if self.engine is not None:
            self.engine.say_again(neighbour)

    def _note_link(self, version: int) -> None:
        self._linking.discard(version)
        self._linked.add(version)

    def _say_ready(self, version: int) -> None:
        has_it = self.engine is not None and self.engine.wiring_of(version) is not None
        if version in self._linked and has_it:
            self._report(control.Ready(self.name, self.process, version, ""))

    def save(self, engine: Engine, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        wiring = engine.wiring
        place = (wiring.instance, wiring.roster)
        self._checkpoints.save(Checkpoint(epoch, attempt, *place, True, start, now, engine.under_way))

    def lacks(self, version: int) -> None:
        if version not in self._fetched and len(self._fetched) < MAX_PREPARED:
            self._fetched.add(version)
            self._report(control.Fetch(self.name, self.process, version))

    def fetch_again(self) -> None:
        """Ask once more for the versions of which messages are held."""
        for version in sorted(self._fetched):
            self._report(control.Fetch(self.name, self.process, version))

    def rewired(self, version: int) -> None:
        self._refused.clear()
        self._failure = None
        self._take_up(version)
        self._alone_in = {later: alone for later, alone in self._alone_in.items() if later > version}
        self.port.unlink(version)
        self._linked = {later for later in self._linked if later >= version}
        self._fetched = {later for later in self._fetched if later > version}
        self._rosters = {later: roster for later, roster in self._rosters.items() if later >= version}

    def _take_up(self, version: int) -> None:
        """Who fails alone from now on; nobody has said so of a version that changes nothing here."""
        if version in self._alone_in:
            self.alone, self.tried = self._alone_in[version]
            self._tried_in = None

    def log_level(self, header: Header, verdict: Verdict) -> int:
        # Before it knows of an epoch; or more than is kept while its roster is on its way.
        early = verdict is Verdict.NEW_ROSTER or (verdict is Verdict.AHEAD and not self.active)
        if not early and verdict not in (Verdict.OLD_ROSTER, Verdict.OTHER_INSTANCE, Verdict.FOREIGN):
            return logging.WARNING
        # To be expected when nodes come and go: one is told.
        like_it = ("early" if early else verdict.value, header.sender)
        if like_it in self._refused or len(self._refused) >= REFUSED_TOLD:
            return logging.DEBUG
        self._refused.add(like_it)
        return logging.INFO

    def _offer(self, request: str) -> control.Join:
        read, fault = None, ""
        try:
            read = self._checkpoints.read()
        except (HieraxError, SchemaError) as error:
            fault = str(error)
        if read is None:
            return control.Join(self.name, self.process, request, control.NEVER, False, fault)
        saved, self._saved = read
        return control.Join(self.name, self.process, request, saved.epoch, False, "", saved.roster, saved.attempt)

    def _prepare(self, order: control.Prepare) -> None:
        try:
            roster = Roster.read(order.roster)
        except SchemaError as error:
            _log.warning("%s: dropped what is no roster: %s", self.name, error)
            return
        version = roster.version
        if self.name not in roster.nodes or not all(end in roster.nodes for edge in roster.edges for end in edge.pair):
            _log.warning("%s: refused version %d of the roster: it has no place there", self.name, version)
            return
        engine = self.engine
        newer = engine is not None and version > engine.wiring.roster
        if engine is not None and newer and engine.begun and roster.instance(self.name) != engine.wiring.instance:
            self.join()  # another process runs it, if that is so: the owner says it, by way of the supervisor
            return
        if self._is_far(version):
            _log.warning("%s: refused version %d of the roster: further ahead than can be", self.name, version)
            return
        self._check_same(roster)
        self._fetched.discard(version)
        self._alone_in[version] = (frozenset(order.alone), frozenset(order.tried))
        self._say_ready(version)
        if version in self._linked or version in self._linking:
            return
        if engine is not None and not newer:
            return
        try:
            wiring = self._wire_roster(roster)
        except HieraxError as error:
            self._refuse(version, error)
            return
        if engine is None:
            try:
                engine = self.run(wiring, self._saved, joins=self._saved is None).engine
            except OperatorError as error:  # s⁰
                why = str(error).removeprefix(f"{self.name}: ")
                self._report(control.Ready(self.name, self.process, version, why))
                return
            self._take_up(version)
        self._rosters[version] = roster
        self._link(wiring, self.linked)
        engine.prepare(wiring)
        self._say_ready(version)

    def _refuse(self, version: int, error: HieraxError) -> None:
        """Say why a roster cannot be run here; in the log once, as whoever asks for it asks again."""
        why = str(error)
        if self._refusals.is_new(why):
            _log.warning("%s: roster version %d is refused: %s", self.name, version, why)
        self._report(control.Ready(self.name, self.process, version, why))

    def _is_far(self, version: int) -> bool:
        engine = self.engine
        if engine is None:
            return False
        full = version not in engine.prepared and len(engine.prepared) >= MAX_PREPARED
        return full or version - engine.wiring.roster > ROSTERS_AHEAD

    def _check_same(self, roster: Roster) -> None:
        """Raises `ContradictionError` if a version is another roster than when it came before: one was forged."""
        known = self._rosters.get(roster.version)
        if known is not None and not known.is_as(roster):
            what = f"two rosters of version {roster.version} were sent to it that differ"
            raise ContradictionError(f"{self.name}: {what}: somebody else speaks in the name of the roster's owner")

    def _go_on_as(self, order: control.Unchanged) -> None:
        """A version that changes nothing here: there is nothing to load, and nobody waits for an answer.

        Where the earlier one lacks, the version is fetched when its first message comes."""
        version = order.version
        self._fetched.discard(version)
        engine = self.engine
        if version in self._linked or version in self._linking or engine is None:
            return
        wiring = engine.wiring_of(order.earlier)
        if wiring is not None and version > engine.wiring.roster and not self._is_far(version):
            again = wiring.under(version)
            self._link(again, self._note_link)
            engine.prepare(again)

    def _link(self, wiring: Wiring, opened: Callable[[int], None]) -> None:
        """First the links: what is held for the version may be taken, and answered, at once."""
        self._linking.add(wiring.roster)
        self.port.link(wiring.node.below, wiring.node.above, wiring.roster, wiring.place.instances, opened)

    def _hand_over(self, order: control.HandOver) -> None:
        engine = self.engine
        if engine is None:
            return
        if engine.epoch == order.epoch and engine.phase is Phase.DONE:
            engine.go_back_to(order.attempt)
            # As a new process in this one's place would have it: whoever asks again is told the same.
            newest = self._checkpoints.newest
            under_way = engine.under_way if newest is None else newest.under_way
            self._report(control.State(self.name, order.version, engine.encoded, under_way))
        elif engine.epoch == order.epoch + 1 and not isinstance(engine, RatedEngine):  # else it was given up
            self._report(control.State(self.name, order.version, engine.encoded_start))

    def _take_over(self, order: control.TakeOver) -> None:
        engine = self.engine
        if order.version == self._took and (order.state, order.under_way) != self._taken:
            what = f"two states to take over under version {order.version} of the roster were sent to it that differ"
            raise ContradictionError(f"{self.name}: {what}: somebody else speaks in the name of the roster's owner")
        if engine is None or engine.begun or order.version < self._took:
            return  # late: it has taken over, and gone on
        try:
            state = taken_over(engine.node, order.state)
        except (HieraxError, SchemaError) as error:
            self._report(control.Taken(self.name, order.version, f"cannot take over the belief: {error}"))
            return
        self._took, self._taken = order.version, (order.state, order.under_way)
        engine.take_over(Saved(order.epoch, order.attempt, state, state, order.under_way))
        now, instance = engine.encoded, order.version  # as of all nodes that are new in a version
        place = (order.epoch, order.attempt, instance, order.version)
        self._checkpoints.save_first(Checkpoint(*place, True, now, now, engine.under_way))
        self._report(control.Taken(self.name, order.version, ""))
