"""What the processes of a launch are started with."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.deployment.secrets import public_settings
from hierax.runtime.execution.world_member import has_record, read_record
from hierax.runtime.host.run_folder import run_folder
from hierax.runtime.host.run_secret import certificates_of, end_of, issued
from hierax.runtime.launch.doors import NO_DOORS, Doors, doors_of
from hierax.runtime.launch.frames import BEGIN, COME_BACK, NodeOrder
from hierax.runtime.launch.recorders import Recorders
from hierax.runtime.launch.run_file import Run, outdate_run, write_run
from hierax.runtime.loading.allowance import module_of
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recording.info import RunInfo
from hierax.runtime.recovery.disk import kept_at
from hierax.runtime.recovery.slots import Slots
from hierax.schemas.access import READER, Access
from hierax.schemas.checkpoint import WorldRecord, decode_processes, decode_roster, decode_trial
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import Reference, Roster

ANSWER_TIMEOUT_S = 5.0


class NotBegunError(HieraxError):
    """A run was ended before its first epoch: there is nothing to go on with."""


class OverError(HieraxError):
    """A run has come to its end: there is nothing to go on with."""


@dataclass(frozen=True)
class LaunchOptions:
    """What the user decides on a launch, beside its deployment."""

    seed: int  # of all random numbers
    epochs: int | None  # how many; None: until the world has finished
    state: Path  # folder of the checkpoints
    output: Path | None = None  # folder for the states, digests and what probes write; None: nothing is written
    host: str | None = None  # address of this machine at which processes on others may join; None: none may
    overrides: Sequence[str] = ()  # with which the deployment file was read, for those who read it again
    passing: bool = False  # whether the folder of the checkpoints goes with the run


class Orders:
    """Makes the orders of one run: of a new one, or of one that is resumed from the checkpoints in its folder."""

    def __init__(
        self,
        deployment: Deployment,
        run_id: str,
        hub: str,
        options: LaunchOptions,
        resumed: Run | None = None,
        secret: str = "",
    ) -> None:
        self.deployment = deployment  # what is run
        self.run_id = run_id  # the identification of the run
        self.hub = hub  # endpoint of the supervisor
        self.secret = secret  # of the run; empty: it is open
        self.access = access_of(deployment)
        self.options = options  # of the launch
        self.overrides = public_settings(options.overrides, deployment.zenoh)  # of secret ones the paths alone
        self.resumed_after = 0  # the last epoch that was committed before the run was resumed
        self.recorders = Recorders()  # those who record the run, wherever they are
        self.resumes = resumed is not None  # whether the run goes on with one that was written down
        self.left: tuple[str, str] | None = None  # a node and its process that, as a run was left, had been replaced
        self._terms = dict(deployment.terms)
        self._coming: Mapping[str, Mapping[str, ProcessTerms]] = {}
        self._lineages: dict[str, str] = {}
        if resumed is not None:
            self._take_up(resumed)

    def order(
        self,
        name: str,  # of the node
        token: str,  # of the process
        life: str,  # how it comes into the run
        *,
        shares: str = "",  # the name of the process that it shares with others
        request: str = "",  # of a newcomer, the change that it is for
        reference: Reference | None = None,  # of a newcomer, its class
        terms: ProcessTerms | None = None,  # of a newcomer, how its process is kept
        processes: Mapping[str, str] | None = None,  # of the world's process, those of all nodes
    ) -> NodeOrder:
        deployment = self.deployment
        reference = reference or deployment.roster.nodes.get(name)
        is_world = name == deployment.roster.world
        terms = terms or self.terms(name)
        doors = self._doors.get(shares or name, NO_DOORS) if life == BEGIN else NO_DOORS
        lineage = _lineage_of(name, request) if request else self._lineage(name)
        return NodeOrder(
            name=name,
            process=token,
            shares=shares,
            life=life,
            request=request,
            deployment=deployment.name,
            run=self.run_id,
            roster=None if life == COME_BACK or request else deployment.roster,
            modules=deployment.modules,
            preload=() if reference is None else (module_of(reference.target),),
            seed=self.options.seed,
            epochs=self.options.epochs,
            staleness=deployment.staleness.epochs,
            rate_hz=terms.rate_hz,
            late=deployment.late,
            budget_ms=terms.budget_ms,
            period_ms=self._period_ms(),
            rated=deployment.roster.timing is not None,
            scheduling=terms.scheduling,
            hub=self.hub,
            door=doors.own,
            doors=doors.others,
            host=self.options.host or "",
            secret=self.secret,
            access=self.access if certificates_of(self.secret) else None,
            lifetime_s=deployment.certificates_s,
            settings=deployment.zenoh,
            low_latency=deployment.low_latency,
            output="" if self.options.output is None else str(self.options.output),
            probes=deployment.probes,
            import_paths=tuple(deployment.import_paths),
            checkpoint=str(self.options.state / lineage),
            durability=deployment.durability,
            owner=self._owner_policy() if is_world else None,
            on_uncertain_act=deployment.on_uncertain_act,
            processes=dict(processes or {}) if is_world else {},
            alone=tuple(sorted(name for name, each in deployment.terms.items() if each.fails_alone)),
            recorded=self.recorders.are_there,
        )

    @cached_property
    def _doors(self) -> Mapping[str, Doors]:
        """Of processes that begin with the run; none where links are as Zenoh's settings say, or to other machines, or
        where some of the processes may not know of them."""
        deployment = self.deployment
        settings = deployment.zenoh or os.environ.get("ZENOH_CONFIG")
        if settings or deployment.hosts or self.options.host or self.resumes:
            return {}
        roster = deployment.roster
        return doors_of(roster, together(deployment, roster.nodes), run_folder(self.run_id))

    def _period_ms(self) -> float | None:
        """The time from an epoch to the next, where the world has a rate with the barrier."""
        rate_hz = self.terms(self.deployment.roster.world).rate_hz
        return 1e3 / rate_hz if rate_hz is not None and self.deployment.staleness.barrier else None

    def has_begun(self, world: str) -> bool:
        """Whether a process of the world's that is dead has begun the run: only with a record is anything sent."""
        name = self.deployment.roster.world
        try:
            record = self._world_record()
            # one of another process is that of another run
            return record is not None and bool(decode_processes(record.processes)[name][0] == world)
        except (HieraxError, SchemaError):
            return True  # its next process says what is wrong with it

    def _world_record(self) -> WorldRecord | None:
        """What the world has recorded; None: nothing, so that the run has not begun."""
        world = self.deployment.roster.world
        storage = kept_at(self.options.state / self._lineage(world), self.deployment.durability)
        if storage is None:
            return None
        with storage:
            slots = Slots(storage)
            return read_record(slots)[0] if has_record(slots) else None

    def again(self, order: NodeOrder, token: str, processes: Mapping[str, str]) -> NodeOrder:
        """The order of the process that comes in the place of another."""
        is_world = order.owner is not None
        return self.anew(
            order,
            token,
            life=COME_BACK,
            request="",
            roster=None,
            owner=self._owner_policy() if is_world else None,
            processes=dict(processes),
        )

    def anew(self, order: NodeOrder, token: str, **changes: Any) -> NodeOrder:
        """The order of the process that comes in the place of one that was killed; as that was before the run began."""
        return replace(order, process=token, recorded=self.recorders.are_there, **changes)

    def elsewhere(self, order: NodeOrder, host: str) -> NodeOrder:
        """The order for a process on another machine, with its address for this one; empty: it is this machine."""
        own = replace(order, output="", checkpoint="", import_paths=(), settings=None, probes=())
        own = replace(own, host=host, elsewhere=True)
        return replace(own, secret="") if own.access is None else own.admitted()  # who keeps it has the secret

    def recorder_secret(self) -> str:
        """With which a recorder that the launch has started is let in."""
        return issued(self.secret, READER, until=end_of(self.deployment.certificates_s))

    def terms(self, name: str) -> ProcessTerms:
        return self._terms.get(name, self.deployment.restart)

    def is_kept(self, order: NodeOrder) -> bool:
        """Whether the next process of a node in force would go on with the checkpoint of an order."""
        return Path(order.checkpoint).name == self._lineage(order.name)

    def _lineage(self, name: str) -> str:
        """What the checkpoint of a node in force is called."""
        return self._lineages.get(name, name)

    def adopt(self, request: str, terms: Mapping[str, ProcessTerms]) -> None:
        """A change is in force: its new nodes, whose terms these are, have checkpoints of their own from then on."""
        self._terms.update(terms)
        for name in terms:
            self._lineages[name] = _lineage_of(name, request)

    def outdate(self) -> None:
        """Have nobody go on with the run by what was written down last: it is no longer so."""
        outdate_run(self.options.state)

    def save(self, coming: Mapping[str, Mapping[str, ProcessTerms]] | None = None) -> None:
        """Write down, beside the checkpoints, what it takes to go on with the run. `coming`: the terms of new nodes, by
        change that was not answered yet; the world may have recorded it before its answer is here."""
        self._coming = self._coming if coming is None else coming
        run = Run(
            deployment=str(self.deployment.path.resolve()),
            settings=self.overrides,
            seed=self.options.seed,
            epochs=self.options.epochs,
            output="" if self.options.output is None else str(self.options.output.absolute()),
            terms=_plain(self._terms),
            coming={request: _plain(terms) for request, terms in self._coming.items()},
        )
        write_run(self.options.state, run, self.deployment.durability == "host")

    def _take_up(self, run: Run) -> None:
        try:
            self._terms = _read_terms(run.terms)
            self._coming = {request: _read_terms(terms) for request, terms in run.coming.items()}
        except (TypeError, AttributeError) as error:
            raise HieraxError(f"{self.options.state}: its restarts are not of this version: {error}") from error

    def _go_on_from(self, record: WorldRecord) -> None:
        """Know what processes go on from, by the world's record: a change that is there was made, whether or not the
        launch lived to hear of it."""
        for name, (_, _, _, request) in decode_processes(record.processes).items():
            if request != os.path.basename(request):
                what = f"expected the identification of the change with which {name} came, got {request!r:.40}"
                raise HieraxError(f"{self.options.state}: the world's record: {what}")
            if request:
                known = self._coming.get(request, {})
                self.adopt(request, {name: known.get(name, self.terms(name))})
        trial = decode_trial(record.trial)
        self.left = None if trial is None else (trial[0], trial[2][0])

    def roster(self) -> Roster:
        """The roster with which the run begins, or goes on. Raises `HieraxError` if it cannot go on, or may not."""
        if not self.resumes:
            return self.deployment.roster
        record = self._world_record()
        if record is None:
            why = "the run was ended before its first epoch; launch it anew, with --overwrite"
            raise NotBegunError(f"{self.options.state}: there is nothing to resume: {why}")
        self.resumed_after = record.epoch - 1
        if self.options.epochs is not None and self.resumed_after >= self.options.epochs:
            raise OverError(f"{self.over}; a greater number of --epochs goes on")
        recorded = decode_roster(record.roster)
        self.deployment.allowance.check_all(recorded)
        self._go_on_from(record)
        return recorded

    @property
    def over(self) -> str:
        """Why a run cannot be resumed that has come to its end."""
        done = f"the run is over, it has done {self.resumed_after} epochs"
        return f"{self.options.state}: there is nothing to resume: {done}"

    def info(self, from_start: bool) -> RunInfo:
        """What a recording says of the run. `from_start`: whether it begins with the run."""
        return RunInfo.of(self.deployment, self.run_id, "launch", self.options.seed, self.overrides, from_start)

    def _owner_policy(self) -> OwnerPolicy:
        deployment = self.deployment
        return OwnerPolicy(
            modules=deployment.modules,
            on_loss={name: each.on_loss for name, each in self._terms.items()},
            rejoin_timeout_s={name: each.rejoin_timeout_s for name, each in self._terms.items()},
            alone=tuple(sorted(name for name, each in self._terms.items() if each.fails_alone)),
            epoch_deadline_s=deployment.epoch_deadline_s,
            start_timeout_s=deployment.start_timeout_s,
            answer_timeout_s=ANSWER_TIMEOUT_S,
            rated=deployment.roster.rates is not None,
            overlaps=deployment.overlaps,
        )


def _lineage_of(name: str, request: str) -> str:
    """What the checkpoint of a node is called that came with a change."""
    return f"{name}@{request}"


def _plain(terms: Mapping[str, ProcessTerms]) -> dict[str, dict[str, Any]]:
    return {name: vars(each) for name, each in terms.items()}


def _read_terms(terms: Mapping[str, Mapping[str, Any]]) -> dict[str, ProcessTerms]:
    return {name: ProcessTerms(**fields) for name, fields in terms.items()}


def together(deployment: Deployment, names: Iterable[str]) -> dict[str, list[str]]:
    """The nodes of each process, by its name; a process of one node has the node's."""
    placed = {name: process for process, nodes in deployment.processes.items() for name in nodes}
    found: dict[str, list[str]] = {}
    for name in sorted(names):
        found.setdefault(placed.get(name, name), []).append(name)
    return {process if len(nodes) > 1 else nodes[0]: nodes for process, nodes in found.items()}


def access_of(deployment: Deployment) -> Access:
    """Who has roles of their own in a run: the nodes of the deployment file, whether or not it is resumed later."""
    roster = deployment.roster
    return Access(roster.world, {name: tuple(nodes) for name, nodes in together(deployment, roster.nodes).items()})
