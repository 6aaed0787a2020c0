"""What others ask of a launch that runs: changes of its roster, and how it does."""

from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import partial
from secrets import token_hex
from typing import Any, get_args, get_type_hints

import anyio
import anyio.from_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.deployment.rates import TOGETHER
from hierax.runtime.deployment.read import RATELESS
from hierax.runtime.host.run_secret import certificates_of
from hierax.runtime.host.scheduling import POLICIES
from hierax.runtime.launch.audit import Audit, asker
from hierax.runtime.launch.child import ProcessState
from hierax.runtime.launch.frames import COME_BACK, NEWCOMER, new_process
from hierax.runtime.launch.roster_supervisor import RosterSupervisor
from hierax.runtime.loading.allowance import NotAllowedError, Refusals
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.transport.control import CHANGES, Reply
from hierax.runtime.transport.hub import Hub
from hierax.schemas.control import Propose
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.roster import Attach, Change, Replace, new_nodes, read_change
from hierax.schemas.values import Value

PS, RECORD = LOOKS = ("ps", "record")
CHANGE, AWAIT, RENEW = CHANGES  # what can be asked for, on a key each; see `Requests`


MAX_CHANGES = 8  # how many changes may be under way at once

MAX_NEWCOMERS = 16
"""How many processes of nodes that are not in force yet they may need together; a single one may need
`MAX_NEW_NODES`."""

MAX_NEW_NODES = 64

MAX_QUESTIONS = 64  # how many questions are answered at once

_SHOWN = {
    ProcessState.ENDED: "restarting",
    ProcessState.RESTARTING: "restarting",
    ProcessState.ELSEWHERE: "elsewhere",
    ProcessState.CUT_OFF: "cut off",
}
"""What `ps` calls the states of processes; all others are those of one that runs."""

LONGEST_S = 1e9


class Requests:
    """Answers queries; each is a map, as is the reply.

    ``{"ask": "ps"}`` is answered with what runs. ``{"ask": "change", "change", "terms", "here"}`` is answered with
    ``{"epoch"}``, the first one under the changed roster when it is committed, or ``{"refusal"}``; ``by`` says who
    asks, for the audit; a node that takes another's place without terms of its own has those of that one. With ``here``
    the processes of new nodes are kept by who asks: the answer is ``{"request", "orders"}``, what they are to be
    started with, and ``{"ask": "await", "request"}`` is answered in the end. ``{"ask": "renew", "name", "process",
    "host"}`` is answered with ``{"secret"}``: a new certificate for one of these. ``{"ask": "record"}`` says that
    somebody is about to record; the answer is the fields of a `RunInfo`, and of an `Access`."""

    def __init__(self, processes: RosterSupervisor, audit: Audit) -> None:
        self._processes = processes
        self._audit = audit  # what is told of changes, made and refused
        self._changes = processes.changes
        self._refusals = Refusals()
        self._beginning = 0
        self._newcomers = 0
        self._questions = 0

    @asynccontextmanager
    async def served(self, hub: Hub) -> AsyncIterator[None]:
        async with anyio.from_thread.BlockingPortal() as portal:

            def on_query(allowed: Sequence[str], data: Value, reply: Reply) -> None:
                if self._questions >= MAX_QUESTIONS:
                    reply({"refusal": f"{MAX_QUESTIONS} questions are being answered; try again"})
                    return
                self._questions += 1
                portal.start_task_soon(self._handle, allowed, data, reply)

            hub.serve(partial(on_query, LOOKS), partial(on_query, CHANGES))
            hub.watch(partial(portal.start_task_soon, self._processes.on_gone))
            try:
                yield
            finally:
                hub.stop_serving()
                await portal.stop(cancel_remaining=True)

    async def _handle(self, allowed: Sequence[str], query: Value, reply: Reply) -> None:
        try:
            reply(await self._answer(allowed, query))
        except (HieraxError, SchemaError) as error:
            if isinstance(error, NotAllowedError) and self._refusals.is_new(str(error)):
                self._processes.notify(f"a change is refused: {error}")
            reply({"refusal": str(error)})
        finally:
            self._questions -= 1

    async def _answer(self, allowed: Sequence[str], query: Value) -> Value:
        if not isinstance(query, dict):
            raise SchemaError(f"expected a map, got {shown(query)}", "question")
        ask = query.get("ask")
        if not isinstance(ask, str) or ask not in allowed:
            raise SchemaError(f"expected {' or '.join(allowed)} on this key, got {shown(ask)}", "question.ask")
        if ask == PS:
            return self._status()
        if ask == RECORD:
            orders = self._processes.orders
            orders.recorders.expect()
            return {**orders.info(from_start=False).plain(), "access": orders.access.plain()}
        if ask == AWAIT:
            request = query.get("request")
            if not isinstance(request, str):
                raise SchemaError(f"expected a text, got {shown(request)}", "question.request")
            return await self._changes.wait(request)
        if ask == RENEW:
            return await self._renewed(query)
        return await self._change_if_room(query)

    async def _renewed(self, query: Mapping[str, Value]) -> Value:
        """A certificate for a process that others keep, and that the owner counts on."""
        name, process, host = (query.get(field) for field in ("name", "process", "host"))
        if not (isinstance(name, str) and isinstance(process, str) and isinstance(host, str)):
            raise SchemaError("expected the name of a node, its process, and an address", "question")
        processes = self._processes
        if processes.members.get(name) != process:
            await processes.hear_members()  # it may just have come
        if processes.members.get(name) != process or processes.child(process) is not None:
            raise HieraxError(f"{shown(name)}: the launch counts on no such process that others keep")
        if not certificates_of(processes.orders.secret):
            raise HieraxError(f"{name}: this launch has no certificates")
        return {"secret": processes.orders.elsewhere(processes.orders.order(name, process, COME_BACK), host).secret}

    async def _change_if_room(self, query: dict[str, Any]) -> Value:
        """So many changes at once, and no more: each may need processes, and the owner makes one after the other."""
        try:
            change = read_change(query.get("change"))
        except SchemaError as error:
            self._audit.refused(str(error), asker(query))
            raise
        await self._processes.started.wait()
        try:
            return await self._begin_if_room(change, query)
        except (HieraxError, SchemaError) as error:
            self._audit.settled(change, asker(query), {"refusal": str(error)})
            raise

    async def _begin_if_room(self, change: Change, query: dict[str, Any]) -> Value:
        new = len(new_nodes(change))
        if new > MAX_NEW_NODES:
            raise HieraxError(f"a change of {new} new nodes: at most {MAX_NEW_NODES} come at once")
        under_way = len(self._changes.unanswered) + self._beginning
        coming = sum(len(change.terms) for change in self._changes.unanswered) + self._newcomers
        if under_way >= MAX_CHANGES:
            raise HieraxError(f"{under_way} changes are under way, and no more may be at once; try again")
        if coming and coming + new > MAX_NEWCOMERS:
            raise HieraxError(f"{coming} processes of new nodes are coming up; try again")
        self._beginning += 1
        self._newcomers += new
        try:
            request = await self._begin(change, query)
        finally:
            self._beginning -= 1
            self._newcomers -= new
        return request if isinstance(request, dict) else await self._changes.wait(request)

    async def _begin(self, change: Change, query: dict[str, Any]) -> Value:
        """Ask the owner for a change; gives the request, or the whole answer where others keep the processes."""
        processes = self._processes
        here, host = query.get("here", False), query.get("host", "")
        if not isinstance(here, bool) or not isinstance(host, str):
            raise SchemaError("expected true or false, and an address", "question.here, question.host")
        processes.orders.deployment.allowance.check_all(change)
        await self._check(change)
        terms = {name: self._terms_of(change, query, name) for name in new_nodes(change)}
        self._check_rates(terms)
        request = token_hex(4)
        proposal = Propose(
            request,
            change.plain(),
            {name: each.on_loss for name, each in terms.items()},
            {name: float(each.rejoin_timeout_s) for name, each in terms.items()},
            tuple(sorted(name for name, each in terms.items() if each.fails_alone)),
        )
        self._changes.add(proposal, terms, partial(self._audit.settled, change, asker(query)))
        orders = [
            processes.orders.order(
                name, new_process(name), NEWCOMER, request=request, reference=reference, terms=terms[name]
            )
            for name, reference in new_nodes(change).items()
        ]
        processes.save()
        await processes.send_to_owner(proposal)  # first: who comes for what nobody has asked for is turned away
        if here:
            orders = [processes.orders.elsewhere(order, host) for order in orders]
            return {"request": request, "orders": [order.plain() for order in orders]}
        for order in orders:
            await processes.start(order)
        return request

    def _terms_of(self, change: Change, query: Mapping[str, Any], name: str) -> ProcessTerms:
        """How a new node's process is kept: as who asks says, or as the one whose place it takes."""
        said = query.get("terms")
        if isinstance(change, Replace) and isinstance(said, dict) and name not in said:
            return self._processes.orders.terms(name)
        return _terms_of(query, name)

    async def _check(self, change: Change) -> None:
        """What the owner would refuse, before processes are started for it."""
        try:
            self._check_names(change)
        except HieraxError:
            await self._processes.hear_members()  # what is known here may be older than the last change
            self._check_names(change)

    def _check_rates(self, terms: Mapping[str, ProcessTerms]) -> None:
        """Who asks may not have read the deployment file, as who reads a snippet for it has."""
        deployment = self._processes.orders.deployment
        for name, each in terms.items():
            if each.fails_alone and deployment.roster.rates is not None:
                raise HieraxError(f"node {name!r} cannot have 'on_loss: detach': {TOGETHER}")
            is_world = name == deployment.roster.world
            if each.rate_hz is not None and not deployment.staleness.has_rate(is_world=is_world):
                raise HieraxError(f"node {name!r} cannot have a rate of {each.rate_hz:g} Hz: {RATELESS}")

    def _check_names(self, change: Change) -> None:
        members = self._processes.members
        if isinstance(change, Attach):
            taken = sorted(change.nodes.keys() & members.keys())
            if taken:
                raise HieraxError(
                    f"cannot attach {taken[0]!r}: there is a node {taken[0]!r} already; replace it, or detach it first"
                )
        elif change.name not in members:
            known = did_you_mean(change.name, members, "the nodes are")
            raise HieraxError(f"cannot {change.plain()['change']} {change.name!r}: there is no such node{known}")

    def _status(self) -> Value:
        processes = self._processes
        deployment = processes.orders.deployment
        nodes = {}
        for name, token in sorted(processes.members.items()):
            child = processes.child(token)
            nodes[name] = {
                "process": token,
                "pid": None if child is None else child.process.pid or None,  # of one elsewhere it may not be known yet
                "shares": "" if child is None else child.order.shares,
                "host": "" if child is None else child.host,
                "state": "cut off" if child and child.is_silent else _SHOWN.get(processes.state(token), "running"),
                "restarts": processes.restarts_of(name),
                "instance": processes.instances.get(name, 0),
            }
        return {
            "hierarchy": deployment.name,
            "run": processes.orders.run_id,
            "file": str(deployment.path.resolve()),  # who asks may be in another folder
            "settings": list(processes.orders.overrides),
            "epoch": processes.epoch,
            "roster": processes.version,
            "nodes": nodes,
        }


def _terms_of(query: Mapping[str, Any], name: str) -> ProcessTerms:
    """How a new node's process is kept. Raises `SchemaError` if that is not said as it should be."""
    terms = query.get("terms")
    fields = terms.get(name) if isinstance(terms, dict) else None
    where = f"question.terms.{name}"
    if not isinstance(fields, dict) or not fields.keys() <= _TERMS.keys():
        raise SchemaError(f"expected a map with some of the keys {', '.join(_TERMS)}", where)
    for field_name, value in fields.items():
        if not _TERMS[field_name](value):
            raise SchemaError(f"got {shown(value)}", f"{where}.{field_name}")
    return ProcessTerms(**fields)


def _is_time(value: Value) -> bool:
    return type(value) in (int, float) and 0 <= value < LONGEST_S


def _is_rate(value: Value) -> bool:
    return value is None or (_is_time(value) and value != 0)


def _is_scheduling(value: Value) -> bool:
    if not isinstance(value, dict) or value.keys() != {"policy", "priority", "cpus"}:
        return False
    priority, cpus = value["priority"], value["cpus"]
    return (
        value["policy"] in POLICIES
        and type(priority) is int
        and 1 <= priority <= 99
        and (
            cpus is None
            or (isinstance(cpus, (list, tuple)) and all(type(cpu) is int and 0 <= cpu < 4096 for cpu in cpus))
        )
    )


def _one_of(field_name: str) -> Callable[[Value], bool]:
    known = get_args(get_type_hints(ProcessTerms)[field_name])
    return lambda value: isinstance(value, str) and value in known


_TERMS: Mapping[str, Callable[[Value], bool]] = {
    "restart_policy": _one_of("restart_policy"),
    "max_restarts": lambda value: type(value) is int and value >= 0,
    "restart_delay_s": _is_time,
    "max_restart_delay_s": _is_time,
    "restart_window_s": lambda value: value is None or _is_time(value),
    "rejoin_timeout_s": _is_time,
    "on_loss": _one_of("on_loss"),
    "rate_hz": _is_rate,
    "budget_ms": _is_rate,
    "scheduling": lambda value: value is None or _is_scheduling(value),
}
