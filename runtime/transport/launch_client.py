"""The client of a launch: asks its supervisor and its nodes, and listens to what they show.

Nothing of the run goes through here, and nothing waits for it. Tools do not subscribe to the keys of edges: what is put
there waits for slow receivers, and a tool that its user has stopped would hold the run up. A node shows copies, which
are dropped where they cannot go at once (`hierax.runtime.transport.control`).
"""

import logging
import os
import socket
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import zenoh

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.run_secret import whose
from hierax.runtime.loading.allowance import Refusals
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.transport.access_control import launch_alone
from hierax.runtime.transport.control import CHANGES, answers_on
from hierax.runtime.transport.node_answers import is_answer
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import ZenohConfig, address_of, close_session, open_session
from hierax.schemas.access import OPERATOR, READER
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import Keys, is_name
from hierax.schemas.roster import Change, Roster
from hierax.schemas.values import Value

FIND_TIMEOUT_S = 5.0  # how long it may take until the launch's session has heard of the client's
FOUND_TIMEOUT_S = 2.0  # how long supervisors may take to say which runs they supervise

NODES_TIMEOUT_S = 2.0
CHANGE_TIMEOUT_S = 120.0
"""How long a change may take: new processes import what they need, and the epoch under way must end."""

LOOK_AGAIN_S = 0.02
KNOCK_TIMEOUT_S = 5.0

Answer = dict[str, Any]

_log = logging.getLogger("hierax")


class AnswerError(HieraxError):
    """A launch refuses what it is asked, or gives an answer that cannot be read."""


@dataclass(frozen=True)
class LaunchStatus:
    """A launch, as its supervisor describes it."""

    hierarchy: str  # the name of the hierarchy
    run: str  # the identification of the run
    epoch: int  # the last one committed, as far as the supervisor has heard
    roster: int  # the version in force
    nodes: Mapping[str, Mapping[str, Any]]  # by name: ``process``, ``pid``, ``state``, ``restarts``, ``instance``

    @staticmethod
    def read(answer: Answer) -> "LaunchStatus":
        """Read it from the answer to ``{"ask": "ps"}``. Raises `AnswerError` if it is none."""
        sound = all(fits(answer.get(field)) for field, fits in _STATUS.items())
        if not sound or not all(is_name(name) and _is_row(row) for name, row in answer["nodes"].items()):
            raise AnswerError("the launch gave an answer that cannot be read")
        return LaunchStatus(*(answer[field] for field in _STATUS))

    def check_node(self, name: str) -> None:
        """Raise `HieraxError`, with the nearest name, if the launch has no node of this one."""
        if name not in self.nodes:
            known = did_you_mean(name, self.nodes, "the nodes are")
            raise HieraxError(f"there is no node {name!r} in {self.hierarchy}, run {self.run}{known}")


def _is_text(value: Value) -> bool:
    return isinstance(value, str) and value.isprintable()


def _is_number(value: Value) -> bool:
    return type(value) is int


_STATUS: Mapping[str, Callable[[Value], bool]] = {
    "hierarchy": is_name,
    "run": is_name,
    "epoch": _is_number,
    "roster": _is_number,
    "nodes": lambda value: isinstance(value, dict),
}
_ROW: Mapping[str, Callable[[Value], bool]] = {
    "process": _is_text,
    "pid": lambda value: value is None or _is_number(value),
    "shares": _is_text,
    "host": _is_text,
    "state": _is_text,
    "restarts": _is_number,
    "instance": _is_number,
}
"""What is told of a node's process."""


def _is_row(row: Value) -> bool:
    if not isinstance(row, dict) or not {"process", "state"} <= row.keys():
        return False
    return all(fits(row[field]) for field, fits in _ROW.items() if field in row)


class LaunchClient:
    """Asks one launch, in a session of its own, on that run's keys alone. Raises `TransportError`."""

    def __init__(
        self, endpoint: str, zenoh_config: ZenohConfig = None, keys: Keys | None = None, secret: str = ""
    ) -> None:
        self.endpoint = endpoint  # of the hub
        self._keys = keys  # of the run; None: they are found out, which fails where several answer
        self._unread = Refusals()
        self._role, until = whose(secret) or (OPERATOR, None)  # whose key it has; the run's own will do for that
        try:  # a client, as the processes of the run would link to a peer
            self._session = open_session(
                (), [endpoint], zenoh_config, False, "client", secret=secret, role=OPERATOR, access=launch_alone()
            )
        except TransportError as error:
            what = f"{error}{_hint(endpoint, secret, until)}"
            raise TransportError(f"the launch at {endpoint} cannot be reached: {what}") from error

    def keys(self) -> Keys:
        """The keys of the run, found out where nobody has said them; that fails where several launches answer."""
        if self._keys is None:
            self._keys = self._found()
        return self._keys

    def ask(self, question: Value, timeout_s: float = 60.0) -> Answer:
        """What the supervisor answers (see `launch.requests`). Raises `AnswerError` if it refuses."""
        patience = time.monotonic() + FIND_TIMEOUT_S
        changes = isinstance(question, dict) and question.get("ask") in CHANGES
        key = self.keys().changes if changes else self.keys().launch
        while time.monotonic() < patience:  # whom nobody has heard of yet is not waited for by `get`
            for _, answer in self._get(key, question, timeout_s):
                if not isinstance(answer, dict):
                    raise AnswerError(f"the launch at {self.endpoint} gave an answer that is no map: {shown(answer)}")
                if "refusal" in answer:
                    raise AnswerError(str(answer["refusal"]))
                return answer
            time.sleep(LOOK_AGAIN_S)
        raise TransportError(f"the launch at {self.endpoint} does not answer")

    def status(self, timeout_s: float = 60.0) -> LaunchStatus:
        """What runs now. Raises `HieraxError` if there is no answer, or none that can be read."""
        return LaunchStatus.read(self.ask({"ask": "ps"}, timeout_s))

    def ask_nodes(
        self, status: LaunchStatus, question: Mapping[str, Value], names: Collection[str]
    ) -> dict[str, Answer]:
        """What nodes answer, as `answers_of`; of a node's processes, only the one that has its place counts. Whose
        answer is not of the shape that was asked for is left out, which is said once."""
        found, unread = self._answers(status, question, names)
        for name in unread:
            if self._unread.is_new(name):
                _log.warning("%s: left out, as its process gives answers that cannot be read", name)
        return found

    def change(self, change: Change, terms: Mapping[str, object], here: bool = False, host: str = "") -> Answer:
        """Have the roster change, with terms of new nodes' processes; what the launch answers when the change counts,
        or at once, where its processes are kept `here`. Raises `AnswerError` if it is refused."""
        if self._role == READER:
            raise AnswerError("the key is a reader's, who looks and changes nothing; expected an operator's")
        told = {name: vars(each) for name, each in terms.items()}
        question = {"ask": "change", "change": change.plain(), "terms": told, "here": here, "host": host, "by": _self()}
        return self.ask(question, CHANGE_TIMEOUT_S)

    def edges(self, status: LaunchStatus) -> list[tuple[str, str]]:
        """The edges of a launch, as (lower, upper), in order."""
        answers = self.ask_nodes(status, {"look": "neighbours"}, status.nodes)
        return sorted((lower, name) for name, answer in answers.items() for lower in answer["below"])

    def node_state(self, status: LaunchStatus, name: str) -> Answer:
        """What a node believes. Raises `HieraxError` if there is no such node, or its process does not answer."""
        status.check_node(name)
        found, unread = self._answers(status, {"look": "state"}, [name])
        if unread:
            raise AnswerError(f"{name}: its process gave an answer that cannot be read")
        answer = found.get(name)
        if answer is None:
            state = status.nodes[name]["state"]
            raise TransportError(f"{name}: its process does not answer; the launch says that it is {state}")
        if "refusal" in answer:
            raise AnswerError(f"{name}: {answer['refusal']}")
        return answer

    def roster(self, status: LaunchStatus) -> Roster:
        """The roster in force. Raises `HieraxError` if the world's process does not tell it."""
        told = [each["roster"] for each in self.ask_nodes(status, {"look": "roster"}, status.nodes).values()]
        found = [each for each in told if each is not None]
        if not found:
            raise TransportError(f"the launch at {self.endpoint} does not tell its roster")
        return Roster.read(found[0])

    def answers_of(
        self, question: Value, names: Collection[str], timeout_s: float = NODES_TIMEOUT_S
    ) -> dict[str, list[Value]]:
        """All that nodes answer to a question of `launch.inspection_server`, by name; of two processes of a node, both.

        All have the time together; who answers sooner is asked again where others are waited for.
        """
        patience = time.monotonic() + timeout_s
        answers: dict[str, list[Value]] = {}
        missing = set(names)
        while missing:
            where = self.keys().look(next(iter(missing)) if len(missing) == 1 else "*")
            left_s = max(patience - time.monotonic(), LOOK_AGAIN_S)
            came: dict[str, list[Value]] = {}
            for key, answer in self._get(where, question, left_s):
                came.setdefault(key.rpartition("/")[2], []).append(answer)
            answers.update({name: came[name] for name in sorted(missing & came.keys())})
            missing -= came.keys()
            if not missing or time.monotonic() >= patience:
                break
            time.sleep(LOOK_AGAIN_S)
        return answers

    def listen(self, key: str, heard: Callable[[str, bytes], None]) -> None:
        """Have `heard` called with key and bytes of every sample on matching keys, in a thread of Zenoh's."""

        def on_sample(sample: zenoh.Sample) -> None:
            said = str(sample.key_expr)
            if "*" not in said:  # else it is on many keys at once, and no node says that
                heard(said, sample.payload.to_bytes())

        try:
            self._session.declare_subscriber(key, on_sample)
        except zenoh.ZError as error:
            raise TransportError(f"{key!r} is no key to listen to: {error}") from error

    def close(self) -> None:
        close_session(self._session)

    def __enter__(self) -> "LaunchClient":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _answers(
        self, status: LaunchStatus, question: Mapping[str, Value], names: Collection[str]
    ) -> tuple[dict[str, Answer], list[str]]:
        """What the processes that have nodes' places answer, and the nodes whose one answers, but in no shape that was
        asked for."""
        told = {
            name: [each for each in answers if _is_of(each, status.nodes[name]["process"])]
            for name, answers in self.answers_of(question, names).items()
        }
        look = str(question["look"])
        found = {name: each for name, answers in told.items() for each in answers if is_answer(look, each)}
        return found, [name for name, answers in told.items() if answers and name not in found]

    def _get(self, key: str, question: Value, timeout_s: float) -> Iterator[tuple[str, Value]]:
        try:
            yield from answers_on(self._session, key, question, timeout_s)
        except (zenoh.ZError, SchemaError) as error:
            raise TransportError(f"the launch at {self.endpoint} cannot be asked: {error}") from error

    def _found(self) -> Keys:
        """The keys of the one run whose supervisor answers here, and says of itself that it supervises this run."""
        patience = time.monotonic() + FIND_TIMEOUT_S
        while time.monotonic() < patience:
            found: set[tuple[str, str]] = set()
            for key, answer in self._get(Keys("*", "*").launch, {"ask": "ps"}, FOUND_TIMEOUT_S):
                hierarchy, run = key.split("/")[1:3]
                if isinstance(answer, dict) and (answer.get("hierarchy"), answer.get("run")) == (hierarchy, run):
                    found.add((hierarchy, run))
            if len(found) > 1:
                named = ", ".join(sorted(f"{run} ({hierarchy})" for hierarchy, run in found))
                raise TransportError(f"several launches answer at {self.endpoint}, and one at most is there: {named}")
            for hierarchy, run in found:
                return Keys(hierarchy, run)
            time.sleep(LOOK_AGAIN_S)
        raise TransportError(f"the launch at {self.endpoint} does not answer")


def _is_of(answer: Value, process: str) -> bool:
    return isinstance(answer, dict) and answer.get("process") == process


def _self() -> str:
    """Who asks for a change, for the launch's audit."""
    return f"user {os.getuid()} on {socket.gethostname()}, process {os.getpid()}"


def _hint(endpoint: str, secret: str, until: datetime | None) -> str:
    """What may be wrong where no link came to be; Zenoh tells nobody why it refuses one."""
    if until is not None and until < datetime.now(timezone.utc):
        return f"; this key was good until {until.astimezone():%Y-%m-%d %H:%M:%S}"
    if not _answers(endpoint):
        return ""
    if secret:
        return "; something listens there, and does not take this key: it is that of another run, or the launch is open"
    return "; something listens there: a launch that is closed takes only who has its key (--key FILE)"


def is_gone(endpoint: str) -> bool:
    """Whether there is no launch at an endpoint any more; not so where its machine cannot be reached."""
    try:
        _knock(endpoint)
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return False


def _answers(endpoint: str) -> bool:
    with suppress(OSError):
        _knock(endpoint)
        return True
    return False


def _knock(endpoint: str) -> None:
    """Open a connection, and close it. Raises `OSError` if there is none to be had, also where no machine can have such
    a name, or no program such a port."""
    try:
        socket.create_connection(address_of(endpoint), timeout=KNOCK_TIMEOUT_S).close()
    except (ValueError, OverflowError) as error:
        raise OSError(f"{endpoint} is no address: {error}") from error
